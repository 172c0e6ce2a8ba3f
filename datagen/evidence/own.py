"""The evidence of each object: the detections of its own light against all detections."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datagen.compiled import compiled
from datagen.detector import Exposure, Spad
from datagen.detector.own_light import detections_per_photon, own_light
from datagen.errors import InputError
from datagen.evidence.image import ScanPairs
from datagen.records import Scalar, Transient
from datagen.records.arrays import Floats
from datagen.records.checks import as_names, check_kind, check_mapping
from datagen.records.label_fields import names_made_by

OBJECT_EVIDENCE = names_made_by("evidence.own")
"""Names of the stored tables of evidence, which have a row for each object."""


@dataclass(frozen=True)
class Evidence:
    """The evidence of an object: s_i are the expected detections of its own light in bin i, b_i those of all light.

    Attributes
    ----------
    detections : Σ s_i over the exposure and all histograms.
    brightest_bin : the largest s_i.
    significance : √Σ s_i²/b_i, in standard deviations of an ideal matched filter.
    """

    detections: float
    brightest_bin: float
    significance: float


UNKNOWN = Evidence(np.nan, np.nan, np.nan)
"""Evidence of an object whose own light the transient does not separate."""


def own_evidence(
    transient: Transient, spad: Spad, exposure: Exposure, parts: Iterable[str] | None = None, *,
    in_sight: Mapping[str, Floats] | None = None,
) -> dict[str, Evidence]:  # fmt: skip
    """Part name → evidence of the part's own light, that of three bounces with the second on it, in a detector.

    Significance is √Σ s²/b over all bins, with s the expected detections of the part's photons and b those of all
    light, after gate, dead time and jitter. Detections of several parts add up.

    Parameters
    ----------
    transient : result of `simulate`, with its `parts`. If its primary was sampled, noise adds to the significance.
    spad, exposure : as of `detect`.
    parts : names of parts; left out, all parts.
    in_sight : further light of parts in plain sight, of one to three bounces (`datagen.evidence.light_in_sight`).
        Left out, none, which is right if everything is hidden around the corner.

    Raises
    ------
    InputError : a part that the transient does not separate; arguments that `detect` refuses.

    Examples
    --------
    A box brings a tenth of 10⁴ detections in a detector without noise, 1 000 ± 100:

    >>> import datagen as dg, numpy as np
    >>> time, light = dg.TimeAxis(bins=1, width_s=1e-9), np.full((1, 1, 1), 1e-9)
    >>> t = dg.Transient(time, {"primary": light}, {"wall": light, "box": 0.1 * light}, 0 * light, 0 * light[0],
    ...                  np.zeros((1, 3)))
    >>> exposure = dg.Exposure(cycles=10**4, photons_per_pulse=1e9)
    >>> evidence = dg.own_evidence(t, dg.Spad(pde=1, mode="ideal"), exposure, ["box"])["box"]
    >>> round(evidence.detections), round(evidence.significance, 2)
    (1000, 10.0)
    """
    check_kind("transient", transient, Transient)
    if in_sight is not None:
        check_mapping("in_sight", in_sight, np.ndarray, remedy="the light in sight of each part")
    return evidence_and_gain(transient, spad, exposure, parts, in_sight=in_sight)[0]


def evidence_and_gain(
    transient: Transient, spad: Spad, exposure: Exposure, parts: Iterable[str] | None = None,
    scan_pairs: ScanPairs | None = None, in_sight: Mapping[str, Floats] | None = None,
) -> tuple[dict[str, Evidence], Floats]:  # fmt: skip
    """The result of `own_evidence`, and (S, bin) `detections_per_photon` of the scan pairs' histograms, from one
    solution for the detector's dead time."""
    names = tuple(transient.parts) if parts is None else as_names("parts", parts, "names of parts")
    for name in names:
        if name not in transient.parts:
            known = ", ".join(transient.parts) or "no part; simulate it with split_parts=True"
            raise InputError(f"own_evidence: part {name!r}: this transient is split by {known}")
    laser, pixel = np.empty((2, 0), np.int64) if scan_pairs is None else scan_pairs.histogram.T
    sums, squares, most = np.zeros((3, len(names)))
    gain = np.empty((len(laser), transient.time.bins))
    if not names and not len(laser):
        return {}, gain
    further = {} if in_sight is None else in_sight
    lights = [transient.parts[n] + further[n] if n in further else transient.parts[n] for n in names]
    for block in own_light(transient.total, lights, transient.time, spad, exposure):
        here = (block.first <= laser) & (laser < block.first + len(block.armed))
        if here.any():
            armed = block.armed[laser[here] - block.first, pixel[here]]
            gain[here] = detections_per_photon(armed, transient.time, spad, exposure)
        for k, own in enumerate(block.own):
            total, square, highest = _sums(own.reshape(-1), block.everything.reshape(-1))
            sums[k] += total
            squares[k] += square
            most[k] = max(most[k], highest)
    each = zip(sums.tolist(), most.tolist(), np.sqrt(squares).tolist(), strict=True)
    return {name: Evidence(*values) for name, values in zip(names, each, strict=True)}, gain


@compiled()
def _sums(own: Floats, everything: Floats) -> tuple[float, float, float]:
    """Σ s, Σ s²/b and the largest s over all bins, in one pass without intermediate arrays."""
    total = square = highest = 0.0
    # The test spares the division in most bins, which hold no light of the object.
    for s, b in zip(own, everything):  # noqa: B905 (not in numba)
        if s > 0.0:
            total += s
            square += s * (s / b)
            highest = max(highest, s)
    return total, square, highest


def evidence_parameters(evidence: Mapping[str, Evidence]) -> dict[str, Scalar]:
    """The evidence as scalars of a sample: `evidence.PART.…`, and the least significance as `evidence.weakest`."""
    if not evidence:
        return {}
    flat: dict[str, Scalar] = {"evidence.weakest": min(one.significance for one in evidence.values())}
    for name, one in evidence.items():
        flat |= {f"evidence.{name}.{quantity}": value for quantity, value in vars(one).items()}
    return flat


def evidence_tables(evidence: Sequence[Evidence], rows: int) -> dict[str, NDArray[np.float32]]:
    """Field name → (rows,) table of the objects in their order; 0 in rows without an object."""
    tables = np.zeros((len(OBJECT_EVIDENCE), rows), np.float32)
    for row, one in enumerate(evidence):
        tables[:, row] = one.detections, one.brightest_bin, one.significance
    return dict(zip(OBJECT_EVIDENCE, tables, strict=True))
