"""Results of the stages: the transient of a capture, and a finished sample."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from datagen.errors import InputError
from datagen.records.arrays import Floats
from datagen.records.capture import TimeAxis
from datagen.records.checks import check_flag, check_integer, check_kind, check_mapping, check_reals

Scalar = float | int | str | bool
_NUMBERS = (int, float, np.integer, np.floating)


SCAN_PLACE = ("labels.scan_right_m", "labels.scan_up_m")
"""Parameters of a sample: metres right and up from the middle of its label images to the middle of its scan."""

OF_THE_DEVICE = (
    "laser_points", "laser_normals", "sensor_pixels", "sensor_points", "sensor_normals", "laser_position",
    "sensor_position",
)  # fmt: skip
"""Arrays of a sample that say where the device is and what it looks at: with an axis of frames where it moves."""
OF_THE_ROOM = ("relay_wall", "hidden_view", "hidden_bounds")
"""Those that say where wall and hidden part are, which stand."""


@dataclass(frozen=True, repr=False)
class Transient:
    """Expected photons at the aperture per emitted photon and time bin, as an impulse response.

    Attributes
    ----------
    time : the time axis of the bins.
    components : "direct", "primary", "secondary", "higher" → (L, P, T) float64; only those simulated.
    parts : the primary split by the part on which the hidden vertex lies, part name → (L, P, T). Of a beam with cells
        (`Laser.flood`, devices) also the light of one bounce that the part sends straight back.
    stderr : (L, P, T) standard error of `total` from independent replicates; NaN when there was only one. That of
        three bounces by cuts is known for each histogram, and shared among its bins in proportion to their light.
    overflow : (L, P) energy that arrives outside the window.
    laser_points : (L, 3) where each laser ray met the scene, metres; NaN where it met nothing. For a flood L here is
        the number of its points, and 1 in the other arrays.
    seconds : wall-clock seconds of the simulation by stage.
    claimed_error : with an accuracy target, the relative L2 error that is claimed, an estimate; None with a number of
        samples. Up to 1.0 its name was `error_bound`, which goes on to work with a warning.
    met_target : whether the claimed error is within a quarter of the target, and each object's within the part
        target; None with a number of samples.
    part_errors : with an accuracy target, object part → estimated relative L2 error of its own primary. Parts fainter
        than `Accuracy.faint_part`, or than 10⁻⁴ of the primary, are left out, and all parts where the primary is
        found by paths. The error may be above the part target where an object is nearly hidden.
    samplers : component → how its light was found: "cuts", "blocks" or "paths" (docs/physics.md).
    rays : component → rays that its light took.

    Raises
    ------
    InputError : values of other types, arrays of other shapes or bins, no components.
    """

    time: TimeAxis
    components: Mapping[str, Floats]
    parts: Mapping[str, Floats]
    stderr: Floats
    overflow: Floats
    laser_points: Floats
    seconds: Mapping[str, float] = field(default_factory=dict)
    claimed_error: float | None = None
    met_target: bool | None = None
    part_errors: Mapping[str, float] = field(default_factory=dict)
    samplers: Mapping[str, str] = field(default_factory=dict)
    rays: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_kind("Transient.time", self.time, TimeAxis)
        check_mapping("Transient.components", self.components, np.ndarray, remedy="name → (L, P, T) light")
        check_mapping("Transient.parts", self.parts, np.ndarray, remedy="name → (L, P, T) light")
        if not self.components:
            raise InputError("Transient.components: none given; at least one such as 'primary' is needed")
        first = next(iter(self.components.values()))
        shape = (*(first.shape[:2] if first.ndim == 3 else (None, None)), self.time.bins)
        for kind in ("components", "parts"):
            for name, light in getattr(self, kind).items():
                check_reals(f"Transient.{kind}[{name!r}]", light, shape)
        check_reals("Transient.stderr", self.stderr, shape)
        check_reals("Transient.overflow", self.overflow, shape[:2])
        check_reals("Transient.laser_points", self.laser_points, (None, 3))
        for name, what in (("seconds", "stage"), ("rays", "component"), ("part_errors", "part")):
            check_mapping(f"Transient.{name}", getattr(self, name), *_NUMBERS, remedy=f"{what} → number")
        check_mapping("Transient.samplers", self.samplers, str, remedy="component → sampler")
        if self.claimed_error is not None:
            check_kind("Transient.claimed_error", self.claimed_error, *_NUMBERS)
        if self.met_target is not None:
            check_flag("Transient.met_target", self.met_target)

    def __repr__(self) -> str:
        lasers, pixels, bins = self.stderr.shape
        error = "no error known" if np.isnan(self.relative_error) else f"relative error {self.relative_error:.2g}"
        met = {True: ", target met", False: ", target not met", None: ""}[self.met_target]
        return (
            f"<Transient of {lasers} laser points × {pixels} pixels × {bins} bins: components "
            f"{', '.join(self.components)}; parts {', '.join(self.parts) or 'none'}; {error}{met}>"
        )

    @cached_property
    def total(self) -> Floats:
        """(L, P, T): the sum of the components."""
        first, *rest = self.components.values()
        return sum(rest, start=first) if rest else first

    @property
    def relative_error(self) -> float:
        """Relative L2 error of the whole transient: with a target the one claimed, else the estimate
        ‖stderr‖ / ‖total‖; 0 for a transient without light."""
        if self.claimed_error is not None:
            return self.claimed_error
        norm = float(np.linalg.norm(self.total))
        return float(np.linalg.norm(self.stderr)) / norm if norm > 0 else 0.0

    @property
    def error_bound(self) -> float | None:
        """The former name of `claimed_error`, which is an estimate and no bound."""
        _warn_of_bound()
        return self.claimed_error


def _warn_of_bound() -> None:
    what = "Transient.error_bound is an estimate and no bound; its name is claimed_error"
    warnings.warn(what, FutureWarning, stacklevel=3)


def _with_former_name(init: Callable[..., None]) -> Callable[..., None]:
    """The constructor of `Transient`, which also takes `claimed_error` by its former name."""

    @functools.wraps(init)
    def accepting(self: Transient, *values: Any, **named: Any) -> None:
        if "error_bound" in named:
            _warn_of_bound()
            named.setdefault("claimed_error", named.pop("error_bound"))
        init(self, *values, **named)

    return accepting


Transient.__init__ = _with_former_name(Transient.__init__)  # type: ignore[method-assign]


@dataclass(frozen=True)
class Sample:
    """What a dataset stores of one scene.

    arrays : field name → array, as `store/schema.py` describes them (no scene axis).
    parameters : scalars for the table `samples.parquet`: drawn numbers, error estimates, decisions about effects.
    seconds : wall-clock seconds by stage ("scene", "transport", "detector", "background", "evidence", "labels").

    Raises `InputError` for values of other types; shapes are compared with the dataset's schema when it is written.
    """

    index: int
    arrays: Mapping[str, NDArray[np.generic]]
    parameters: Mapping[str, Scalar]
    seconds: Mapping[str, float]

    def __post_init__(self) -> None:
        check_integer("Sample", "index", self.index, 0, 2**53)
        check_mapping("Sample.arrays", self.arrays, np.ndarray, np.generic, remedy="field → array")
        check_mapping("Sample.parameters", self.parameters, object, remedy="name → number, text, true or false")
        for name, value in self.parameters.items():
            if not isinstance(value, float | int | str | np.generic):
                kind = type(value).__name__
                raise InputError(f"parameter {name}: {kind} made, must be a number, a text, true or false")
        check_mapping("Sample.seconds", self.seconds, *_NUMBERS, remedy="stage → seconds")


class OnSurfaces(NamedTuple):
    """Points where n rays first meet the scene.

    position : (n, 3) metres. normal : (n, 3) unit normal of the surface, on the side that the ray comes from. NaN
    where a ray meets nothing, or where what it meets is unknown.
    """

    position: Floats
    normal: Floats

    @classmethod
    def unknown(cls, count: int) -> OnSurfaces:
        """`count` points of which nothing is known."""
        return cls(np.full((count, 3), np.nan), np.full((count, 3), np.nan))


def geometry_fields(
    lit: OnSurfaces, sensor_pixels: Floats, seen: OnSurfaces, laser_position: Floats, sensor_position: Floats,
    relay_wall: Floats | None = None, hidden_view: Floats | None = None, hidden_bounds: Floats | None = None,
) -> dict[str, Floats]:  # fmt: skip
    """The arrays of a sample that say where laser, sensor, relay wall and hidden part are; NaN where that is unknown.

    lit, seen : the laser points, and what the middle of each pixel looks at. sensor_pixels : (P, 4, 3) corners.
    relay_wall, hidden_view : (3, 3) rows center, right, up. hidden_bounds : (2, 3) corners.
    """
    return {
        "laser_points": lit.position,
        "laser_normals": lit.normal,
        "sensor_pixels": sensor_pixels,
        "sensor_points": seen.position,
        "sensor_normals": seen.normal,
        "laser_position": laser_position,
        "sensor_position": sensor_position,
        "relay_wall": np.full((3, 3), np.nan) if relay_wall is None else relay_wall,
        "hidden_view": np.full((3, 3), np.nan) if hidden_view is None else hidden_view,
        "hidden_bounds": np.full((2, 3), np.nan) if hidden_bounds is None else hidden_bounds,
    }
