"""The evidence that an object is there at all: the measurement with it against the one without it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datagen.detector import Exposure, Spad
from datagen.detector.own_light import own_light
from datagen.errors import InputError
from datagen.records import Accuracy, Capture, Scalar, Scene, Transient
from datagen.records.checks import check_kind, check_seed
from datagen.transport import transient_of


@dataclass(frozen=True)
class Presence:
    """How far an object changes a measurement: by its own light, its shadow, and light that it takes from others.

    Attributes
    ----------
    detections : Σ s_i, expected over the exposure and all histograms; below 0 where it takes more than it brings.
    significance : √Σ s_i²/m_i, in standard deviations of an ideal matched filter, within `floor` of the truth.
    floor : the significance that the errors of both simulations have by themselves. What is not above it may be
        nothing.
    """

    detections: float
    significance: float
    floor: float


UNKNOWN = Presence(np.nan, np.nan, np.nan)
"""Presence of an object in a transient that another simulator made."""


def presence_evidence(
    scene: Scene, capture: Capture, accuracy: Accuracy, spad: Spad, exposure: Exposure,
    parts: Iterable[str] | None = None, *, seed: int = 0, transient: Transient | None = None,
) -> dict[str, Presence]:  # fmt: skip
    """How far a measurement with an object stands from one of the same scene without it.

    With b_i the expected detections with the object, s_i what it adds to them (at the diode's state with it), so that
    b_i − s_i are those without it, the significance is √Σ s_i²/m_i with m_i the larger of the two. The filter
    Σ (s_i/m_i) n_i tells both scenes apart by at least so many standard deviations of either; by just as many where
    s ≪ b. Of an object that shadows nothing it is the significance of its own light.

    Both simulations share their samples of light, so that much of their error cancels in s. What remains, e, moves
    the significance by √Σ e²/m at most (the triangle inequality), which `floor` estimates from the standard errors of
    both as if nothing cancelled. A smaller target lowers it in proportion.

    Parameters
    ----------
    scene, capture, accuracy, seed : as of `simulate`; a simulation for the scene and one for each part.
    spad, exposure : as of `detect`.
    parts : names of parts; left out, those of role object.
    transient : the scene's, as `simulate` gives it with this accuracy and seed; left out, it is simulated here.

    Raises
    ------
    InputError : a part that the scene does not have; what `simulate` and `detect` refuse.

    Examples
    --------
    A black plate brings no light, and is seen by its shadow:

    >>> import datagen as dg, trimesh
    >>> def plate(x, half):
    ...     corners = [(x, -half, -half), (x, half, -half), (x, half, half), (x, -half, half)]
    ...     return trimesh.Trimesh(corners, [(0, 1, 2), (0, 2, 3)], process=False)
    >>> scene = dg.Scene.from_parts([dg.Part("relay_wall", plate(0, 2), dg.Lambertian(0.8), "relay_wall"),
    ...     dg.Part("back", plate(2, 2), dg.Lambertian(0.8), "structure"),
    ...     dg.Part("plate", plate(1, 0.4), dg.Lambertian(0.0))])
    >>> laser = dg.Laser((1.5, -1.5, 0), [(0, 0.2, 0.2)])
    >>> sensor = dg.Sensor.grid((1.5, -1.5, 0), (0, 0.1, 0), (0, 0.1, 0), (0, 0, 0.1), rows=1, columns=1)
    >>> capture = dg.Capture(laser, sensor, dg.TimeAxis(bins=60, width_s=4e-10, origin="wall"))
    >>> exposure = dg.Exposure(cycles=10**4, photons_per_pulse=1e9)
    >>> found = dg.presence_evidence(scene, capture, dg.Accuracy(target=0.02), dg.Spad(mode="ideal"), exposure)
    >>> found["plate"].detections < 0, found["plate"].significance > found["plate"].floor
    (True, True)
    """
    given = (("scene", scene, Scene), ("capture", capture, Capture), ("accuracy", accuracy, Accuracy))
    for name, value, kind in given:
        check_kind(name, value, kind)
    check_seed(seed)
    names = scene.objects if parts is None else tuple(parts)
    for name in names:
        if name not in scene.part_names:
            raise InputError(f"presence_evidence: part {name!r}: this scene has {', '.join(scene.part_names)}")
    if not names:
        return {}
    whole = transient_of(scene, capture, accuracy, seed, split_parts=False) if transient is None else transient
    found = {}
    for name in names:
        without = transient_of(scene.without(name), capture, accuracy, seed, split_parts=False)
        found[name] = _against(whole, without, spad, exposure)
    return found


def _against(whole: Transient, without: Transient, spad: Spad, exposure: Exposure) -> Presence:
    # One replicate tells no error.
    error = np.hypot(whole.stderr, without.stderr)
    change = square = unsure = 0.0
    lights = [whole.total, without.total, np.nan_to_num(error)]
    for of in own_light(whole.total, lights, whole.time, spad, exposure):
        s = of.own[0] - of.own[1]
        # The brighter of both: where a shadow takes everything there is no noise with the object, but much without.
        m = np.maximum(of.everything, of.everything - s)
        weight = np.divide(1.0, m, out=np.zeros_like(m), where=m > 0)
        change += float(s.sum())
        square += float((s * s * weight).sum())
        unsure += float((of.own[2] ** 2 * weight).sum())
    floor = math.sqrt(unsure) if np.isfinite(error).all() else math.nan
    return Presence(change, math.sqrt(square), floor)


def presence_parameters(found: Mapping[str, Presence]) -> dict[str, Scalar]:
    """Presence as scalars: `evidence.PART.presence` (its significance), `.presence_detections` and `_floor`."""
    flat: dict[str, Scalar] = {}
    for name, of in found.items():
        prefix = f"evidence.{name}.presence"
        flat |= {prefix: of.significance, f"{prefix}_detections": of.detections, f"{prefix}_floor": of.floor}
    return flat


def presence_table(found: Sequence[Presence], rows: int) -> NDArray[np.float32]:
    """(rows,) significance of the objects in their order; 0 in rows without one."""
    table = np.zeros(rows, np.float32)
    table[: len(found)] = [of.significance for of in found]
    return table
