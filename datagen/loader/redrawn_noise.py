"""Histograms drawn anew from stored transients, and the number of the next draw of each scene."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import pydantic
import torch
from numba.core import cgutils
from numba.extending import intrinsic
from numpy.typing import NDArray
from torch import distributed

from datagen.compiled import compiled
from datagen.config import CaptureConfig, DetectorConfig, EffectsConfig
from datagen.errors import InputError
from datagen.records.arrays import Ints
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
            self._detector = _stored(DetectorConfig, config["detector"])
            self._effects = _stored(EffectsConfig, config.get("effects", {}))
            self._time = _stored(CaptureConfig, config["capture"]).time.axis()
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
        self, field: str, transient: NDArray[np.generic], scene: int, seed: int, number: int, stream: int = 0
    ) -> NDArray[np.integer[Any]]:
        """(laser, pixel, bin) counts of a scene, with as many bins as its histogram has.

        They are a function of the transient (the values of `field`), `seed`, the number of the draw, the stream of
        the process and the scene.
        """
        from datagen.detector import detect

        spad, exposure, tolerance = self._detector_of(scene, transient)
        key = seed_sequence(seed, scene, _PURPOSE[field], attempt=number, part=stream)
        noise_seed = int(key.generate_state(1, np.uint64)[0])
        return detect(
            transient.astype(np.float64), self._time, spad, exposure, seed=noise_seed, tolerance=tolerance,
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


def _stored(model: type[Section], values: object) -> Section:
    """A section of the configuration that a dataset stores."""
    return model.model_validate_json(json.dumps(values), context={"look_for_files": False})


class DrawCounter:
    """Counts the draws of each scene. `take` returns the number of the next draw and raises it, `fix` sets it.

    Each scene has a count of its own, because a dataset does not know when an epoch begins: wrappers, samplers and
    workers only pass indices. The number of a draw depends on how often the scene was read, and not on workers,
    prefetching or the order of scenes.

    The processes of distributed training count separately, and read the same scene in turns. So each process draws
    from a stream of its own, except for the first read after `fix`, when the number is the same in all of them.
    """

    def __init__(self, scenes: int) -> None:
        self._rank: int | None = None
        # (2, scene): number of the next draw, and the number that `fix` set last.
        state: Any = torch.tensor([[0], [-1]]).repeat(1, scenes)
        self._state: torch.Tensor = state.share_memory_()
        # Compiled here, once, before workers are forked.
        self.take(())

    def fix(self, epoch: int, scenes: Ints) -> None:
        """Make the next read of each of these scenes draw number `epoch`; later reads count on from there."""
        if not isinstance(epoch, int | np.integer) or not 0 <= epoch < 2**62:
            raise InputError(f"epoch = {epoch!r}: must be a whole number in 0 … 2^62")
        self._state[:, torch.from_numpy(scenes)] = int(epoch)

    def take(self, scenes: Sequence[int]) -> list[tuple[int, int]]:
        """(number, stream) of the next draw of each scene of a batch; later reads get other numbers."""
        rank, (following, fixed) = self._own_rank(), self._state.numpy()
        wanted = np.array(scenes, np.int64)
        draws = zip(_taken(following, wanted).tolist(), fixed[wanted].tolist(), strict=True)
        # Streams 1 and 2 belong to the order of epochs and to splits.
        return [(draw, 0 if draw == first or rank == 0 else rank + 2) for draw, first in draws]

    def __getstate__(self) -> dict[str, Any]:
        """The state with the rank of this process, which a spawned worker takes over."""
        return self.__dict__ | {"_rank": self._own_rank()}

    def _own_rank(self) -> int:
        if distributed.is_available() and distributed.is_initialized():
            return distributed.get_rank()
        launched = os.environ.get("RANK", "")
        return self._rank or (int(launched) if launched.isdigit() else 0)


@intrinsic
def _raised(typing: Any, counts: Any, place: Any) -> Any:
    """counts[place], which is raised by one at the same moment: no other process can read it in between."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array = context.make_array(counts)(context, builder, arguments[0])
        at: Any = cgutils.get_item_pointer
        number = at(context, builder, counts, array, [arguments[1]])
        return builder.atomic_rmw("add", number, context.get_constant(counts.dtype, 1), "seq_cst")

    return counts.dtype(counts, place), code


@compiled()
def _taken(counts: Ints, places: Ints) -> Ints:
    """(n,) counts at these places, each of which is raised by one."""
    taken = np.empty(len(places), np.int64)
    for i in range(len(places)):
        taken[i] = _raised(counts, places[i])  # type: ignore[call-arg]
    return taken
