"""The presence of an object: the evidence by which a measurement with it differs from one without it."""

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
from datagen.records.checks import as_names, check_kind, check_seed
from datagen.transport import transient_of


@dataclass(frozen=True)
class Presence:
    """The change of a measurement by an object: by its own light, its shadow, and the light it takes from others.

    Attributes
    ----------
    detections : Σ s_i expected over the exposure and all histograms; negative if the object takes more than it
        brings.
    significance : √Σ s_i²/m_i, in standard deviations of an ideal matched filter, within `floor` of the truth.
    floor : the significance that the errors of both simulations alone would have. A significance that is not above it
        may be due to these errors.
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
    """Part name → the evidence that separates a measurement of the scene from one of the scene without the part.

    Let b_i be the expected detections with the object and s_i its contribution (for the state of the diode with it),
    so that b_i − s_i are the detections without it. The significance is √Σ s_i²/m_i with m_i the larger of the two.
    The filter Σ (s_i/m_i) n_i separates both scenes by at least so many standard deviations of either, and by just as
    many if s ≪ b. For an object without a shadow it is the significance of its own light.

    Both simulations use the same random numbers, so that much of their error cancels in s. The remaining error e
    changes the significance by at most √Σ e²/m (the triangle inequality). `floor` estimates this from the standard
    errors of both simulations as if nothing cancelled; it falls in proportion to the target.

    Parameters
    ----------
    scene, capture, accuracy, seed : as of `simulate`, which runs once for the scene and once for each part.
    spad, exposure : as of `detect`.
    parts : names of parts; left out, those with the role `object`.
    transient : result of `simulate` for the scene, with this accuracy and seed; left out, it is simulated here.

    Raises
    ------
    InputError : a part that the scene does not have; arguments that `simulate` and `detect` refuse.

    Examples
    --------
    A black plate brings no light, and is detected by its shadow:

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
    >>> presence = dg.presence_evidence(scene, capture, dg.Accuracy(target=0.02), dg.Spad(mode="ideal"), exposure)
    >>> plate = presence["plate"]
    >>> plate.detections < 0, plate.significance > plate.floor
    (True, True)
    """
    given = (("scene", scene, Scene), ("capture", capture, Capture), ("accuracy", accuracy, Accuracy))
    for name, value, kind in given:
        check_kind(name, value, kind)
    check_seed(seed)
    names = scene.objects if parts is None else as_names("parts", parts, "names of parts")
    if transient is not None:
        check_kind("transient", transient, Transient)
    for name in names:
        if name not in scene.part_names:
            raise InputError(f"presence_evidence: part {name!r}: this scene has {', '.join(scene.part_names)}")
    if not names:
        return {}
    whole = transient_of(scene, capture, accuracy, seed, split_parts=False) if transient is None else transient
    simulated = (
        (name, transient_of(scene.without(name), capture, accuracy, seed, split_parts=False)) for name in names
    )
    return presence_against(whole, simulated, spad, exposure)


def presence_against(
    whole: Transient, without: Iterable[tuple[str, Transient]], spad: Spad, exposure: Exposure
) -> dict[str, Presence]:
    """Part name → its presence, from the transient of a scene and (part name, transient without that part)."""
    return {name: _presence_of(whole, other, spad, exposure) for name, other in without}


def _presence_of(whole: Transient, without: Transient, spad: Spad, exposure: Exposure) -> Presence:
    """The presence of an object, from the transients of the scene with and without it."""
    # With a single replicate the standard error is NaN, and the floor unknown.
    error = np.hypot(whole.stderr, without.stderr)
    change = square = error_square = 0.0
    lights = [whole.total, without.total, np.nan_to_num(error)]
    for block in own_light(whole.total, lights, whole.time, spad, exposure):
        s = block.own[0] - block.own[1]
        # A shadow may leave no detections and thus no noise with the object: the brighter scene has noise.
        m = np.maximum(block.everything, block.everything - s)
        weight = np.divide(1.0, m, out=np.zeros_like(m), where=m > 0)
        change += float(s.sum())
        square += float((s * s * weight).sum())
        error_square += float((block.own[2] ** 2 * weight).sum())
    floor = math.sqrt(error_square) if np.isfinite(error).all() else math.nan
    return Presence(change, math.sqrt(square), floor)


def presence_parameters(presence: Mapping[str, Presence]) -> dict[str, Scalar]:
    """The presence as scalars: `evidence.PART.presence` (its significance), `.presence_detections` and `_floor`."""
    flat: dict[str, Scalar] = {}
    for name, one in presence.items():
        prefix = f"evidence.{name}.presence"
        flat |= {prefix: one.significance, f"{prefix}_detections": one.detections, f"{prefix}_floor": one.floor}
    return flat


def presence_table(presence: Sequence[Presence], rows: int) -> NDArray[np.float32]:
    """(rows,) significance of the objects in their order; 0 in rows without an object."""
    table = np.zeros(rows, np.float32)
    table[: len(presence)] = [one.significance for one in presence]
    return table
