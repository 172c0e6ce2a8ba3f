"""Distributions a configuration can declare for a number that differs from scene to scene.

YAML writes a number for a constant, or one key that names the distribution::

    albedo: 0.7
    albedo: {uniform: [0.3, 0.9]}
    width_m: {log_uniform: [0.1, 1.0]}
    height_m: {normal: {mean: 1.7, std: 0.1, low: 1.4, high: 2.0}}
    rotation_deg: {choice: [0, 45, 90], weights: [2, 1, 1]}
"""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, Discriminator, Field, Tag

from datagen.config.base import Settings


class Uniform(Settings):
    """Uniform between two bounds."""

    uniform: tuple[float, float]

    def _check(self) -> None:
        _check_range("uniform", *self.uniform)

    def _draw(self, rng: np.random.Generator) -> float:
        low, high = self.uniform
        return low + (high - low) * rng.random()

    def _support(self) -> tuple[float, float]:
        return self.uniform


class LogUniform(Settings):
    """Uniform in the logarithm between two positive bounds."""

    log_uniform: tuple[float, float]

    def _check(self) -> None:
        low, high = self.log_uniform
        if low <= 0:
            raise ValueError(f"log_uniform = [{low:g}, {high:g}]: both bounds must be > 0")
        _check_range("log_uniform", low, high)

    def _draw(self, rng: np.random.Generator) -> float:
        low, high = self.log_uniform
        return float(min(max(low * (high / low) ** rng.random(), low), high))

    def _support(self) -> tuple[float, float]:
        return self.log_uniform


class NormalShape(Settings):
    """Mean, standard deviation and the bounds of a truncated normal distribution."""

    mean: float
    std: Annotated[float, Field(gt=0)]
    low: float
    high: float

    def _check(self) -> None:
        _check_range("normal", self.low, self.high)
        if not self.low - 4 * self.std <= self.mean <= self.high + 4 * self.std:
            raise ValueError(
                f"normal mean = {self.mean:g}: more than four std outside low … high = {self.low:g} … {self.high:g}"
            )


class Normal(Settings):
    """Normal, truncated to low … high."""

    normal: NormalShape

    def _draw(self, rng: np.random.Generator) -> float:
        from scipy.special import ndtr, ndtri

        n = self.normal
        below, above = ndtr((n.low - n.mean) / n.std), ndtr((n.high - n.mean) / n.std)
        return float(np.clip(n.mean + n.std * ndtri(below + (above - below) * rng.random()), n.low, n.high))

    def _support(self) -> tuple[float, float]:
        return self.normal.low, self.normal.high


class Choice(Settings):
    """One of several values, equally likely or with weights."""

    choice: Annotated[tuple[float, ...], Field(min_length=1)]
    weights: tuple[Annotated[float, Field(ge=0)], ...] | None = None

    def _check(self) -> None:
        if self.weights is not None and (len(self.weights) != len(self.choice) or sum(self.weights) <= 0):
            raise ValueError(f"weights: {len(self.choice)} weights ≥ 0 with a positive sum are needed, one a value")

    def _draw(self, rng: np.random.Generator) -> float:
        weights = np.ones(len(self.choice)) if self.weights is None else np.asarray(self.weights)
        cumulative = np.cumsum(weights) / np.sum(weights)
        return self.choice[min(int(np.searchsorted(cumulative, rng.random(), side="right")), len(self.choice) - 1)]

    def _support(self) -> tuple[float, float]:
        return min(self.choice), max(self.choice)


def _check_range(name: str, low: float, high: float) -> None:
    if low > high:
        raise ValueError(f"{name} = [{low:g}, {high:g}]: the range is upside down; write the smaller bound first")


def _member(value: Any) -> str | None:
    """The tag of the union's member that a value is to be read as; None for what is no distribution."""
    if isinstance(value, (int, float)):
        return None if isinstance(value, bool) else "number"
    keys = value if isinstance(value, dict) else type(value).model_fields if isinstance(value, Settings) else ()
    tags = {"uniform": "Uniform", "log_uniform": "LogUniform", "normal": "Normal", "choice": "Choice"}
    return next((tag for key, tag in tags.items() if key in keys), None)


Distribution = Annotated[
    Annotated[float, Tag("number")]
    | Annotated[Uniform, Tag("Uniform")]
    | Annotated[LogUniform, Tag("LogUniform")]
    | Annotated[Normal, Tag("Normal")]
    | Annotated[Choice, Tag("Choice")],
    Discriminator(
        _member,
        custom_error_type="distribution",
        custom_error_message="A number is needed, or one of {uniform: [low, high]}, {log_uniform: [low, high]}, "
        "{normal: {mean, std, low, high}}, {choice: [values], weights: [weights]}",
    ),
]


def draw(distribution: Distribution, rng: np.random.Generator) -> float:
    """One value. A constant draws nothing from `rng`."""
    return float(distribution) if isinstance(distribution, (int, float)) else distribution._draw(rng)


def support(distribution: Distribution) -> tuple[float, float]:
    """The smallest and largest value that can be drawn."""
    if isinstance(distribution, (int, float)):
        return float(distribution), float(distribution)
    return distribution._support()


def within(low: float, high: float = np.inf, *, open_low: bool = False) -> AfterValidator:
    """A pydantic validator: all values that can be drawn lie in low … high (low itself excluded if `open_low`)."""

    bounds = [f"{'>' if open_low else '≥'} {low:g}", *([f"≤ {high:g}"] if high < np.inf else [])]

    def check(value: Distribution) -> Distribution:
        smallest, largest = support(value)
        if smallest < low or largest > high or (open_low and smallest <= low):
            drawn = f"{smallest:g}" if smallest == largest else f"{smallest:g} … {largest:g}"
            raise ValueError(f"{drawn} given; must be {' and '.join(bounds)}")
        return value

    return AfterValidator(check)


NotNegative = Annotated[Distribution, within(0)]
Length = Annotated[Distribution, within(0, 1e5, open_low=True)]
"""A distribution of positive lengths, metres."""
Fraction = Annotated[Distribution, within(0, 1)]
"""A distribution of values in 0 … 1, such as an albedo."""


def _whole(value: Distribution) -> Distribution:
    bounds = value.choice if isinstance(value, Choice) else support(value)
    if any(b != int(b) or b < 0 for b in bounds):
        shown = ", ".join(f"{b:g}" for b in dict.fromkeys(bounds))
        raise ValueError(f"{shown} given; whole numbers ≥ 0 are needed")
    return value


Count = Annotated[Distribution, AfterValidator(_whole)]
"""A distribution of whole numbers; `{uniform: [1, 3]}` makes 1, 2 and 3 equally likely."""


def draw_count(count: Distribution, rng: np.random.Generator) -> int:
    """A whole number; continuous distributions other than the uniform are rounded."""
    if isinstance(count, Uniform):
        low, high = count.uniform
        return int(rng.integers(int(low), int(high), endpoint=True))
    return round(draw(count, rng))


def largest_count(count: Distribution) -> int:
    """The most that `draw_count` can give."""
    high = support(count)[1]
    return int(high) if isinstance(count, Uniform) else round(high)
