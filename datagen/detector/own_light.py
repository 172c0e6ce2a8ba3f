"""Expected detections of a transient, and those of them that come from a part of its light.

With λ the flux of all light and λᵒ that of the part (`flux`), D/λ the probability that an event finds the diode armed
(`expected`) and N the number of cycles,

    b_i = N D_i,    s_i = N (D_i / λ_i) λᵒ_i,

both displaced by the jitter of the records. Each avalanche is set off by one photon, and whether this photon belongs
to the part does not depend on what went before; so the detections of several parts add up.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from datagen.detector.expected import detections_and_events
from datagen.detector.flux import Cycle, arrivals, cycle_of
from datagen.detector.measurement import Measurement, with_bins_merged
from datagen.detector.sampler_choice import poisson_bias
from datagen.detector.spad import Exposure, Spad
from datagen.errors import InputError
from datagen.records import TimeAxis
from datagen.records.arrays import Floats

NEGLIGIBLE = 1e-3
"""Share of the detections that dead time may remove, or avalanches add, without being taken into account: far below
what any evidence is known to."""


@dataclass(frozen=True)
class OwnLight:
    """Expected detections of a block of laser points.

    first : number of the block's first laser point.
    everything : (laser, pixel, bin) expected detections over the exposure in the bins of a histogram, background
        included.
    own : (laser, pixel, bin) expected detections of each light's own photons, likewise.
    armed : (laser, pixel, n) probability that an event finds the diode armed, in each bin of the laser period.
    """

    first: int
    everything: Floats
    own: tuple[Floats, ...]
    armed: Floats


def own_light(
    transient: Floats, lights: Sequence[Floats], time: TimeAxis, spad: Spad, exposure: Exposure
) -> Iterator[OwnLight]:
    """Expected detections of a transient and of `lights`, which are parts of it, for one block of laser points after
    another.

    A bin whose counter is full on average carries no information on any light: s_i = 0 there.

    Raises `InputError` for a transient or a gate that `detect` refuses, and lights of another shape.
    """
    measured = Measurement.of(transient, time, spad, exposure)
    for light in lights:
        if light.shape != measured.transient.shape:
            raise InputError(
                f"own_light: a light of shape {light.shape} in a transient of shape {measured.transient.shape}"
            )
    cycle, tdc = measured.cycle, measured.tdc
    for first, flux in measured.fluxes():
        detections, armed = _detections(flux, cycle, spad)
        everything = tdc.mean(exposure.cycles * detections)
        counted = exposure.cycles * spad.pde * exposure.photons_per_pulse * (cycle.gate * armed)
        own = [tdc.mean(counted * arrivals(light[first : first + len(flux)], cycle)) for light in lights]
        if spad.counter_max is not None:
            own = [(everything < spad.counter_max) * one for one in own]
            everything = np.minimum(everything, spad.counter_max)
        seen, *lights_seen = (with_bins_merged(one, spad) for one in (everything, *own))
        yield OwnLight(first, seen, tuple(lights_seen), np.broadcast_to(armed, flux.shape))


def squares_over(own: Floats, everything: Floats) -> Floats:
    """s²/b of each bin, whose sum is the square of a light's significance; 0 where no detection is expected."""
    return own * np.divide(own, everything, out=np.zeros_like(own), where=everything > 0)


def detections_per_photon(armed: Floats, time: TimeAxis, spad: Spad, exposure: Exposure) -> Floats:
    """(…, bin) expected detections over the exposure for each photon at the aperture per emitted photon in a bin:
    N photons_per_pulse PDE gate D/λ.

    armed : (…, n) as of `OwnLight`.
    """
    cycle = cycle_of(time, spad, exposure)
    photons = exposure.cycles * exposure.photons_per_pulse
    return np.asarray((armed * cycle.gate)[..., : time.bins] * (photons * spad.pde))


def _detections(flux: Floats, cycle: Cycle, spad: Spad) -> tuple[Floats, Floats]:
    """(laser, pixel, n) expected detections per cycle of flux (laser, pixel, n), and the probability that an event
    finds the diode armed, of the same shape, or (1,) if it is 1 everywhere."""
    coupled = spad.crosstalk_probability > 0 and flux.shape[1] > 1
    busy = poisson_bias(flux, cycle, spad) > NEGLIGIBLE
    if not busy.any():
        return flux, np.ones(1)
    detections, armed = flux.copy(), np.ones_like(flux)
    rows = np.arange(busy.size).reshape(busy.shape)
    if coupled:
        groups = [*rows[busy.any(axis=1)]]
    else:
        # A self-consistent mean is repeated until it settles, so pixels with traps are solved for one at a time.
        spad = replace(spad, crosstalk_probability=0.0)
        groups = [*rows[busy][:, None]] if spad.afterpulse_probability > 0 else [rows[busy]]
    each, counted, ready = (values.reshape(-1, flux.shape[-1]) for values in (flux, detections, armed))
    for pixels in groups:
        counted[pixels], events = detections_and_events(each[pixels], cycle, spad)
        ready[pixels] = np.divide(counted[pixels], events, out=np.ones_like(events), where=events > 0)
    return detections, armed
