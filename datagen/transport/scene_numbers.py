"""A scene as compiled loops see it: materials, air and embree's frame as plain numbers, for every way to light."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from datagen.records import Scene, TimeAxis
from datagen.records.arrays import Floats, Ints
from datagen.transport.brdf import MaterialTable
from datagen.transport.rays import Raycaster


class SceneNumbers(NamedTuple):
    """What every way to light needs to know of a scene. What one way alone needs is in a record of its own, which
    holds this one, as numba passes each number of a record to each kernel.

    kind, values : the `MaterialTable`. air : attenuation, 1/m. offset : by which ends of rays are lifted off their
    surfaces, m. frame : centre and half extent of embree's frame, m. from_source : whether the legs of the device, to
    the laser point and from the FoV point, count for the time axis; they attenuate in any case.
    """

    kind: Ints | NDArray[np.uint8]
    values: Floats
    air: float
    offset: float
    frame: tuple[float, ...]
    from_source: bool

    @classmethod
    def of(cls, caster: Raycaster, scene: Scene, materials: MaterialTable, time: TimeAxis) -> SceneNumbers:
        """The numbers of a scene. time : the time axis that light is counted on."""
        air, from_source = float(scene.attenuation_per_m), time.origin == "source"
        return cls(materials.kind, materials.values, air, caster.offset_m, caster.frame, from_source)
