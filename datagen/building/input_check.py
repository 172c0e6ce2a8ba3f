"""What can be found wrong with a configuration before a dataset is begun."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import islice
from warnings import warn

import numpy as np

from datagen.capture import capture_for
from datagen.config import DatasetConfig
from datagen.config.distributions import largest_count
from datagen.design.scene_for import scene_for
from datagen.detector import choose_sampler, detector_for
from datagen.devices import share_of_late_zones
from datagen.errors import InputError, InputWarning
from datagen.labels.solids import LARGEST_HOLE_SHARE, open_share
from datagen.labels.triangles import open3d_for_labels
from datagen.pipeline import FrameTimes
from datagen.records import Capture, Scene
from datagen.records.label_fields import LABEL_FIELDS
from datagen.scene import check_scene_config, meshes_named
from datagen.transport.coincidence import set_apart
from datagen.transport.doubts import doubts
from datagen.transport.rays import Raycaster
from datagen.units import path_from_time

SCENES_TRIED = 16
"""Scenes that are generated before a build, without light, to find a configuration that cannot be simulated: one that
fails in one scene of ten passes 19 % of the time."""
LIT_SCENES_TRIED = 4
"""The same where scenes are accepted by their light, which takes seconds for each."""

LATE_SCENES = 0.25
"""Share of the scenes tried in which most zones may look beyond the end of the time axis without a warning: sensors
look into large rooms on purpose."""


def check_inputs(config: DatasetConfig) -> None:
    """Raise `InputError` for what can be found wrong before a dataset is begun: mesh files, a room that cannot be
    furnished or a capture that does not fit it (the first `SCENES_TRIED` scenes are generated), an impossible
    detector, exposures that do not fit into the frames of a sequence, labels without Open3D. Warn of what is possible
    but most likely not meant: no objects, volumes of meshes with holes, bent faces of meshes, zones whose light
    arrives after the time axis ends, and scenes that are too large for their light or shut it in.
    """
    check_scene_config(config.scene)
    if any((of.is_image or of.is_volume) and of.label in config.store.fields for of in LABEL_FIELDS):
        # Labels come last in a scene: without this the light of all scenes would be made in vain.
        open3d_for_labels()
    most = LIT_SCENES_TRIED if config.scene.asks_for_evidence else SCENES_TRIED
    tried = [_scene_and_capture(config, index) for index in range(min(config.scenes, most))]
    if config.clock is not None:
        for index, (_, capture) in enumerate(tried):
            FrameTimes.of(config.clock, capture, *detector_for(config.detector, config.seed, index, capture.time))
    capture = tried[0][1]
    spad, exposure = detector_for(config.detector, config.seed, 0, capture.time)
    dark = np.zeros((1, *capture.shape[1:]))
    tolerance, approximate = config.detector.tolerance, config.detector.approximate
    choose_sampler(dark, capture.time, spad, exposure, tolerance=tolerance, approximate=approximate)
    doubtful = doubtful_scenes(tried, config.transport.direct)
    for warning in (*_most_likely_not_meant(config), *_too_late(config, tried), *doubtful):
        warn(warning, InputWarning, stacklevel=3)


def _most_likely_not_meant(config: DatasetConfig) -> Iterator[str]:
    """A warning for each thing that is possible and most likely not meant: no objects; meshes with holes or bent
    faces."""
    if not any(largest_count(item.count) for item in config.scene.contents):
        yield (
            "scene.contents: no scene has an object, so nothing is hidden and labels are empty; list some, or leave "
            "the key out for a pillar and a box"
        )
    volumes = [of.name for of in LABEL_FIELDS if of.is_volume and of.label in config.store.fields]
    meshes = list(meshes_named(config.scene))
    for where, _, doubt in meshes:
        if doubt:
            yield f"{where}: {doubt}"
    closed = meshes if volumes else ()
    holed = [where for where, of, _ in closed if open_share(of.vertices[of.triangles]) > LARGEST_HOLE_SHARE]
    if holed:
        more = f" and {len(holed) - 1} more" if len(holed) > 1 else ""
        yield (
            f"{holed[0]}{more}: the mesh is not closed, so it has no inside: only its surface is in "
            f"{' and '.join(volumes)}; close it in a mesh editor, or leave the field out (store.fields)"
        )


def parts_in_one_place(scenes: Iterable[tuple[Scene, Capture]]) -> Iterator[str]:
    """A warning if parts of one of the first `SCENES_TRIED` scenes, made in Python, lie in one place.

    In rooms that are drawn objects stand on the floor, an open one with a bottom that is lit: this is meant.
    """
    for index, (scene, capture) in enumerate(islice(scenes, SCENES_TRIED)):
        warning = set_apart(scene, capture).warning
        if warning:
            yield f"scene {index}: {warning}"
            return


def doubtful_scenes(scenes: Iterable[tuple[Scene, Capture]], direct: bool) -> Iterator[str]:
    """A warning if the light of one of the first `SCENES_TRIED` scenes is most likely not what is meant. direct :
    whether light of one and two bounces counts."""
    for index, (scene, capture) in enumerate(islice(scenes, SCENES_TRIED)):
        for doubt in doubts(scene, capture, Raycaster(scene), direct):
            yield f"scene {index}: {doubt}"
            return


def _too_late(config: DatasetConfig, tried: Sequence[tuple[Scene, Capture]]) -> Iterator[str]:
    """A warning if in many of the scenes tried most zones get their direct light after the time axis ends."""
    if not config.transport.direct or config.capture.time.origin != "source":
        return
    late = sum(share_of_late_zones(scene, capture) > 0.5 for scene, capture in tried)
    if late > LATE_SCENES * len(tried):
        reach_m = float(path_from_time(config.capture.time.axis().stop_s)) / 2
        yield (
            f"capture: in {late} of {len(tried)} scenes most zones see things farther away than the time axis "
            f"reaches ({reach_m:.2g} m), so their histograms are empty; bring the device nearer "
            "(at_objects.distance_m, layout.relay_distance_m), or take more bins"
        )


def _scene_and_capture(config: DatasetConfig, index: int) -> tuple[Scene, Capture]:
    """Scene `index`, generated without light, and its capture; an `InputError` names any scene but the first."""
    scene = scene_for(config, index)
    try:
        return scene, capture_for(config, scene, config.seed, index)
    except InputError as error:
        if index == 0:
            raise
        raise InputError(f"scene {index} (seed {config.seed}): {error}") from None
