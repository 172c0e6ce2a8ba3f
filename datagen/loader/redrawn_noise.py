"""The detector's noise drawn anew from a stored transient."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from datagen.config import CaptureConfig, DetectorConfig, EffectsConfig
from datagen.errors import InputError
from datagen.seeding import Purpose, seed_sequence
from datagen.store import Manifest

if TYPE_CHECKING:
    from datagen.detector import Exposure, Spad


TRANSIENT_OF = {"histogram": "transient", "background_histogram": "background_transient"}
_PURPOSE = {"transient": Purpose.LOADER, "background_transient": Purpose.LOADER_BACKGROUND}


class NoiseSource:
    """Counts from a stored transient, with the detector that the scene was given."""

    def __init__(self, manifest: Manifest) -> None:
        config = manifest.config
        try:
            # Only the sections needed: the scene's mesh files may be gone.
            self._detector = DetectorConfig.model_validate_json(json.dumps(config["detector"]))
            self._effects = EffectsConfig.model_validate_json(json.dumps(config.get("effects", {})))
            self._time = CaptureConfig.model_validate_json(json.dumps(config["capture"])).time.axis()
        except (KeyError, ValueError) as error:
            what = " ".join(str(error).split())
            raise InputError(f"redraw_noise: the dataset's own configuration cannot be used ({what})") from None
        if manifest.imported and not config["scene"]["layout"].get("detector_is_known"):
            raise InputError(
                "redraw_noise: an imported dataset says nothing of its detector; import it with "
                "settings={'detector': {…}}"
            )
        self._seed = manifest.seed
        self._decided: dict[tuple[str, int], tuple[Spad, Exposure, float]] = {}

    def draw(
        self, field: str, transient: NDArray[np.generic], scene: int, seed: int, number: int, stream: int = 0
    ) -> NDArray[np.integer[Any]]:
        """Counts of a scene's field with light, (laser, pixel, bin): a function of (field, seed, number of the draw,
        stream, scene)."""
        from datagen.detector import detect

        spad, exposure, tolerance = self._detector_of(field, scene, transient)
        key = seed_sequence(seed, scene, _PURPOSE[field], attempt=number, part=stream)
        noise_seed = int(key.generate_state(1, np.uint64)[0])
        return detect(
            transient.astype(np.float64), self._time, spad, exposure, seed=noise_seed, tolerance=tolerance,
            approximate=self._detector.approximate,
        )  # fmt: skip

    def _detector_of(self, field: str, scene: int, transient: NDArray[np.generic]) -> tuple[Spad, Exposure, float]:
        """The detector of a scene with the effects that its transient calls for, decided once."""
        if (field, scene) not in self._decided:
            from datagen.detector import detector_for
            from datagen.effects import decide_detector_effects

            given = detector_for(self._detector, self._seed, scene, self._time)
            seen = transient.astype(np.float64)
            plan = decide_detector_effects(seen, self._time, *given, self._effects, self._detector.tolerance)
            self._decided[field, scene] = plan.apply_detector(*given, self._detector.tolerance)
        return self._decided[field, scene]
