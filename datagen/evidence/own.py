"""The evidence of each object: its own light against all that is detected."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datagen.compiled import compiled
from datagen.detector import Exposure, Spad
from datagen.detector.own_light import detections_per_photon, own_light, squared_over
from datagen.errors import InputError
from datagen.evidence.image import ScanPairs
from datagen.records import Scalar, Transient
from datagen.records.arrays import Floats

OBJECT_EVIDENCE = ("object_detections", "object_brightest_bin", "object_significance")
"""Stored tables of evidence, a row for each object."""


@dataclass(frozen=True)
class Evidence:
    """How far an object's own light stands out in a measurement.

    Attributes
    ----------
    detections : Σ s_i, expected over the exposure and all histograms.
    brightest_bin : the largest s_i.
    significance : √Σ s_i²/b_i, in standard deviations of an ideal matched filter.
    """

    detections: float
    brightest_bin: float
    significance: float


UNKNOWN = Evidence(np.nan, np.nan, np.nan)
"""Evidence of an object whose own light is not known apart."""


def own_evidence(
    transient: Transient, spad: Spad, exposure: Exposure, parts: Iterable[str] | None = None, *,
    in_sight: Mapping[str, Floats] | None = None,
) -> dict[str, Evidence]:  # fmt: skip
    """The evidence that a detector gives of each part's own light, that of three bounces by way of it.

    Significance is √Σ s²/b over all bins, with s the expected detections of the part's photons and b those of
    everything, after gate, dead time and jitter; detections of several parts add up.

    Parameters
    ----------
    transient : of `simulate`, with its `parts`. Where the primary was sampled, its noise adds to the significance.
    spad, exposure : as of `detect`.
    parts : names of parts; left out, all of them.
    in_sight : of `datagen.evidence.light_in_sight`: light of one to three bounces that parts in plain sight have
        besides. Left out, none: right where everything is hidden around the corner.

    Raises
    ------
    InputError : a part that the transient is not split by; what `detect` refuses.

    Examples
    --------
    A lone wall of which a tenth of the light comes, 10⁴ detections in all in a detector without noise: 1 000 ± 100.

    >>> import datagen as dg, numpy as np
    >>> time, light = dg.TimeAxis(bins=1, width_s=1e-9), np.full((1, 1, 1), 1e-9)
    >>> t = dg.Transient(time, {"primary": light}, {"wall": light, "box": 0.1 * light}, 0 * light, 0 * light[0],
    ...                  np.zeros((1, 3)))
    >>> exposure = dg.Exposure(cycles=10**4, photons_per_pulse=1e9)
    >>> found = dg.own_evidence(t, dg.Spad(pde=1, mode="ideal"), exposure, ["box"])["box"]
    >>> round(found.detections), round(found.significance, 2)
    (1000, 10.0)
    """
    return evidence_and_gain(transient, spad, exposure, parts, in_sight=in_sight)[0]


def evidence_and_gain(
    transient: Transient, spad: Spad, exposure: Exposure, parts: Iterable[str] | None = None,
    scan_pairs: ScanPairs | None = None, in_sight: Mapping[str, Floats] | None = None,
) -> tuple[dict[str, Evidence], Floats]:  # fmt: skip
    """The result of `own_evidence`, and (S, bin) `detections_per_photon` of the scan pairs' histograms: the law of
    the detector's dead time is solved once for both."""
    names = tuple(transient.parts) if parts is None else tuple(parts)
    for name in names:
        if name not in transient.parts:
            known = ", ".join(transient.parts) or "no part; simulate it with split_parts=True"
            raise InputError(f"own_evidence: part {name!r}: this transient is split by {known}")
    laser, pixel = np.empty((2, 0), np.int64) if scan_pairs is None else scan_pairs.histogram.T
    sums, squares, most = np.zeros((3, len(names)))
    gain = np.empty((len(laser), transient.time.bins))
    if not names and not len(laser):
        return {}, gain
    besides = {} if in_sight is None else in_sight
    lights = [transient.parts[n] + besides[n] if n in besides else transient.parts[n] for n in names]
    for found in own_light(transient.total, lights, transient.time, spad, exposure):
        here = (found.first <= laser) & (laser < found.first + len(found.armed))
        if here.any():
            armed = found.armed[laser[here] - found.first, pixel[here]]
            gain[here] = detections_per_photon(armed, transient.time, spad, exposure)
        for k, own in enumerate(found.own):
            total, square, highest = _summed(own.reshape(-1), found.everything.reshape(-1))
            sums[k] += total
            squares[k] += square
            most[k] = max(most[k], highest)
    each = zip(sums.tolist(), most.tolist(), np.sqrt(squares).tolist(), strict=True)
    return {name: Evidence(*values) for name, values in zip(names, each, strict=True)}, gain


@compiled()
def _summed(own: Floats, everything: Floats) -> tuple[float, float, float]:
    """Σ s, Σ s²/b and the largest s, in one pass: arrays between would take longer than all else."""
    total = square = highest = 0.0
    # Most bins hold no light of the object.
    for s, b in zip(own, everything):  # noqa: B905 (not in numba)
        if s > 0.0:
            total += s
            square += s * (s / b)
            highest = max(highest, s)
    return total, square, highest


def significance_in_time(
    transient: Transient, spad: Spad, exposure: Exposure, parts: Iterable[str]
) -> dict[str, NDArray[np.float64]]:
    """Part → (bin,) √Σ s²/b over laser points and pixels: the root of the sum of its squares is the
    significance."""
    names = tuple(parts)
    squares = np.zeros((len(names), transient.time.bins))
    for found in own_light(transient.total, [transient.parts[n] for n in names], transient.time, spad, exposure):
        for k, own in enumerate(found.own):
            squares[k] += squared_over(own, found.everything).sum(axis=(0, 1))
    return dict(zip(names, np.sqrt(squares), strict=True))


def evidence_parameters(found: Mapping[str, Evidence]) -> dict[str, Scalar]:
    """The evidence as scalars of a sample: `evidence.PART.…`, and the least significance, `evidence.weakest`."""
    if not found:
        return {}
    flat: dict[str, Scalar] = {"evidence.weakest": min(of.significance for of in found.values())}
    for name, of in found.items():
        flat |= {f"evidence.{name}.{quantity}": value for quantity, value in vars(of).items()}
    return flat


def evidence_tables(found: Sequence[Evidence], rows: int) -> dict[str, NDArray[np.float32]]:
    """Field → (rows,) table of the objects in their order; 0 in rows without one."""
    tables = np.zeros((len(OBJECT_EVIDENCE), rows), np.float32)
    for row, of in enumerate(found):
        tables[:, row] = of.detections, of.brightest_bin, of.significance
    return dict(zip(OBJECT_EVIDENCE, tables, strict=True))
