"""Histograms as recorded beside those simulated: their errors, and what would explain what is left."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from scipy.ndimage import convolve1d

from datagen.devices.agreement import Fitted, HistogramErrors
from datagen.devices.model import Device
from datagen.devices.surfaces import material_of
from datagen.records import Material
from datagen.records.arrays import Floats

TAIL_BINS = 8.0
"""Decay of the late light that `Comparison.left` looks for, bins: longer than the pulses of sensors of zones, which
would be taken for it, and shorter than their window."""
MOST_ZONES_LISTED = 64
"""Zones up to which the table has a line for each: sensors of 8 × 8 zones have one, cameras do not."""
MEANING = {
    "brightness": "gains of zones, albedos that vary over a part, gloss",
    "time": "places of sensor, mesh and zones; delays; drift",
    "width": "pulse, size of zones, rough surfaces",
    "late light": "light of several bounces, tail of the pulse, what the mesh lacks",
}


@dataclass(frozen=True)
class Comparison(HistogramErrors):
    """Histograms as recorded and as simulated.

    Attributes
    ----------
    source, simulated_as : what was recorded, and by what it was simulated.
    fitted : name → number with its standard error.
    steps : what was fitted so far → median and 90th percentile of the relative L2 of the tested histograms.
    measured, modelled : (n, zones, bins) the tested histograms, counts.
    device : the device as fitted; None for two datasets.
    held_out : whether the fit did not see the tested histograms.
    reflectances : part that was seen → its reflectance back to where light comes from, relative to a white matt
        surface: one number, or one for each of evenly spaced cosines from 0 to 1 where it was fitted by angle.
    """

    source: str
    simulated_as: str
    fitted: dict[str, Fitted]
    steps: dict[str, tuple[float, float]]
    measured: Floats
    modelled: Floats
    device: Device | None = None
    held_out: bool = False
    reflectances: dict[str, tuple[float, ...]] = field(default_factory=dict)

    @property
    def materials(self) -> dict[str, Material]:
        """Part that was seen → its material, for scenes of your own (`write_materials` writes a file of them).

        Raises `InputError` where more light would leave a surface than arrives.
        """
        return {part: material_of(part, values) for part, values in self.reflectances.items()}

    @cached_property
    def residual_sd(self) -> Floats:
        """(zones,) root mean square of (measured − modelled) / √modelled: 1 if Poisson noise alone is left."""
        squares = (self.measured - self.modelled) ** 2 / np.maximum(self.modelled, 1.0)
        return np.asarray(np.sqrt(squares.mean(axis=(0, 2))))

    @cached_property
    def left(self) -> dict[str, float]:
        """What would explain the residuals: effect → share of ‖modelled − measured‖² that it removes if it is free
        in every histogram. Shares overlap, since effects resemble each other; all are 0 where nothing is left."""
        model = self.modelled
        residual = self.measured - model
        slope, bend = np.gradient(model, axis=2), np.gradient(np.gradient(model, axis=2), axis=2)
        taps = np.exp(-np.arange(int(6 * TAIL_BINS)) / TAIL_BINS)
        late = convolve1d(
            model, np.concatenate([np.zeros(len(taps) - 1), taps / taps.sum()]), axis=2, mode="constant"
        )
        weight = 1 / (self.measured**2).sum(axis=2)
        shares = {}
        for name, shape in (("brightness", model), ("time", slope), ("width", bend), ("late light", late)):
            along = (residual * shape).sum(axis=2) ** 2 / np.maximum((shape**2).sum(axis=2), 1e-300)
            left = float((weight * (residual**2).sum(axis=2)).sum())
            shares[name] = float((weight * along).sum()) / left if left > 0 else 0.0
        return shares

    def as_dict(self) -> dict[str, Any]:
        """All numbers, as `datagen compare --json` writes them."""
        error, shift = self.relative_l2, np.abs(self.peak_shift)
        return {
            "source": self.source,
            "simulated_as": self.simulated_as,
            "tested_frames": len(self.measured),
            "held_out": self.held_out,
            "median_relative_l2": float(np.median(error)),
            "p90_relative_l2": float(np.percentile(error, 90)),
            "median_relative_l2_by_zone": np.median(error, axis=0).tolist(),
            "p90_relative_l2_by_zone": np.percentile(error, 90, axis=0).tolist(),
            "residual_sd_by_zone": self.residual_sd.tolist(),
            "peak_shift_bins": {"median": float(np.median(shift)), "p90": float(np.percentile(shift, 90))},
            "peak_shift_bins_by_zone": np.median(self.peak_shift, axis=0).tolist(),
            "fitted": {name: {"value": of.value, "error": of.error} for name, of in self.fitted.items()},
            "steps": {name: {"median": a, "p90": b} for name, (a, b) in self.steps.items()},
            "left": self.left,
            "reflectances": {part: list(values) for part, values in self.reflectances.items()},
        }

    def text(self) -> str:
        """The numbers as a table."""
        error, shift = self.relative_l2, np.abs(self.peak_shift)
        zones = error.shape[1]
        lines = [f"{self.source}, simulated as {self.simulated_as}; {self.tested}", "fitted:"]
        lines += [f"  {name:32} {number}" for name, number in self.fitted.items()]
        lines.append("relative L2 of histograms, median (90th percentile), after fitting")
        lines += [f"  {name:32} {a:.4f} ({b:.4f})" for name, (a, b) in self.steps.items()]
        lines.append(
            f"peak: median of |shift| {np.median(shift):.3f} bins, 90th percentile {np.percentile(shift, 90):.3f}"
        )
        if zones <= MOST_ZONES_LISTED:
            lines.append(
                "by zone: relative L2, residual in standard deviations of Poisson noise, shift of the peak (bins)"
            )
            medians, shifts = np.median(error, axis=0), np.median(self.peak_shift, axis=0)
            lines += [
                f"  {zone:4} {medians[zone]:8.4f} {self.residual_sd[zone]:8.1f} {shifts[zone]:+8.3f}"
                for zone in range(zones)
            ]
        lines.append("of what is left, this would be explained by a free")
        lines += [f"  {name:12} {share:5.0%}  ({MEANING[name]})" for name, share in self.left.items()]
        return "\n".join(lines)
