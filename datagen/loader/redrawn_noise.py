"""Histograms drawn anew from stored transients."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import pydantic
from numpy.typing import NDArray

from datagen.config import CaptureConfig, DetectorConfig, EffectsConfig
from datagen.errors import InputError
from datagen.seeding import Purpose, seed_sequence
from datagen.store import Manifest
from datagen.store.schema import Field

if TYPE_CHECKING:
    from datagen.detector import Exposure, Spad


Section = TypeVar("Section", bound=pydantic.BaseModel)

TRANSIENT_OF = {"histogram": "transient", "background_histogram": "background_transient"}
_PURPOSE = {"transient": Purpose.LOADER, "background_transient": Purpose.LOADER_BACKGROUND}


def drawn_field(name: str, light: str, manifest: Manifest) -> Field:
    """The field of a histogram that is drawn from the field `light`, its transient."""
    stored, merged = manifest.schema.by_name[light], manifest.bins_merged
    *others, bins = stored.shape
    return replace(stored, name=name, dims=(*stored.dims[:-1], "bin"), shape=(*others, bins // merged))


class NoiseSource:
    """Draws counts from a stored transient, with the detector of the scene."""

    def __init__(self, manifest: Manifest) -> None:
        config = manifest.config
        try:
            # Other sections are not parsed, because mesh files that they name may be gone.
            self._detector = _stored_section(DetectorConfig, config["detector"])
            self._effects = _stored_section(EffectsConfig, config.get("effects", {}))
            self._time = _stored_section(CaptureConfig, config["capture"]).time.axis()
        except (KeyError, ValueError) as error:
            what = " ".join(str(error).split())
            raise InputError(f"redraw_noise: the dataset's own configuration cannot be used ({what})") from None
        if manifest.imported and not config["scene"]["layout"].get("detector_is_known"):
            raise InputError(
                "redraw_noise: an imported dataset says nothing of its detector; import it with "
                "settings={'detector': {…}}"
            )
        self._seed = manifest.seed

    def draw(
        self, field: str, transient: NDArray[np.generic], scene: int, seed: int, number: int, stream: int = 0,
        frame: int | None = None,
    ) -> NDArray[np.integer[Any]]:  # fmt: skip
        """(laser, pixel, bin) counts of a scene, or of a frame of a sequence, with as many bins as its histogram has.

        They are a function of the transient (the values of `field`), `seed`, the number of the draw, the stream of
        the process, the scene and the frame.
        """
        from datagen.detector import detect

        light = transient.astype(np.float64)
        if frame is not None:
            # Of sequences it may be below 0 where it is hardly known.
            np.maximum(light, 0.0, out=light)
        spad, exposure, tolerance = self._detector_of(scene, light)
        key = seed_sequence(seed, scene, _PURPOSE[field], attempt=number, part=stream, frame=frame)
        noise_seed = int(key.generate_state(1, np.uint64)[0])
        return detect(
            light, self._time, spad, exposure, seed=noise_seed, tolerance=tolerance,
            approximate=self._detector.approximate,
        )  # fmt: skip

    def _detector_of(self, scene: int, transient: NDArray[np.generic]) -> tuple[Spad, Exposure, float]:
        """Detector, exposure and tolerance of a scene, with the effects that its transient needs.

        They are decided at every draw, in a small part of the time of the draw: kept for every scene they would fill
        the memory of every worker.
        """
        from datagen.detector import detector_for
        from datagen.effects import decide_detector_effects

        given = detector_for(self._detector, self._seed, scene, self._time)
        seen = transient.astype(np.float64)
        plan = decide_detector_effects(seen, self._time, *given, self._effects, self._detector.tolerance)
        return plan.apply_detector(*given, self._detector.tolerance)


def _stored_section(model: type[Section], values: object) -> Section:
    """A section of the configuration that a dataset stores."""
    return model.model_validate_json(json.dumps(values), context={"look_for_files": False})
