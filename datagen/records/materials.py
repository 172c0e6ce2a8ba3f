"""What a surface does to light, as parameters only; `transport/brdf.py` evaluates and samples them."""

from __future__ import annotations

from dataclasses import dataclass

from datagen.errors import InputError


@dataclass(frozen=True)
class Material:
    """Common to all materials: the albedo, the share of arriving light that leaves again (0 to 1)."""

    albedo: float

    def __post_init__(self) -> None:
        if not 0.0 <= self.albedo <= 1.0:
            raise InputError(
                f"{type(self).__name__}.albedo = {self.albedo}: must lie in 0 … 1, or the surface would create light"
            )


@dataclass(frozen=True)
class Lambertian(Material):
    """A perfectly diffuse surface: BRDF = albedo / π in every direction, on both sides."""
