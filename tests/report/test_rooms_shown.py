"""Opening a room: what is in the way goes, what is behind stays, and the picture shows the nearest surface."""

from __future__ import annotations

import numpy as np
import pytest
from handmade_rooms import box_mesh, l_corridor
from matplotlib.colors import to_rgb

from datagen.records import Lambertian, Part, Scene
from datagen.report.rooms import Camera, RoomPicture, Surfaces, cut_open
from datagen.report.style import part_colors


@pytest.mark.parametrize("side", [1, -1])
def test_ceiling_goes_and_floor_objects_and_relay_wall_stay(side: int) -> None:
    scene = l_corridor(side)
    _, faces, outlines = RoomPicture(scene).opened
    kept = {scene.part_names[k] for k in np.unique(scene.face_part[faces])}
    assert {"floor", "pillar", "box", "relay_wall"} <= kept
    assert "ceiling" in scene.part_names and "ceiling" not in kept
    assert len(outlines) > 0


def test_walls_between_viewer_and_room_go_and_those_behind_stay() -> None:
    scene = l_corridor()
    faces, _ = cut_open(scene, Camera.looking(150.0, 42.0))
    kept = {scene.part_names[k] for k in np.unique(scene.face_part[faces])}
    # From −x and +y: the wall at y = −1 and the one that goes on from the relay wall are behind everything.
    assert {"wall_5", "wall_0"} <= kept
    assert not {"wall_1", "wall_2", "wall_3", "wall_4"} & kept


def test_picture_shows_the_nearest_part_where_it_is() -> None:
    below = Part("below", box_mesh((4, 4, 0.1), (0, 0, 0)), Lambertian(0.5))
    above = Part("above", box_mesh((1, 1, 0.1), (1, 1, 1)), Lambertian(0.5))
    scene = Scene.from_parts([below, above])
    camera = Camera.from_above()
    view = Surfaces(scene, np.arange(24)).seen(camera, 500)
    picture, (left, right, bottom, top) = view.shaded(scene, camera, part_colors(scene)), view.extent
    rows, columns = picture.shape[:2]

    def at(x: float, y: float) -> np.ndarray:
        return picture[int((top - y) / (top - bottom) * rows), int((x - left) / (right - left) * columns)]

    hue = {name: np.array(to_rgb(color)) for name, color in part_colors(scene).items()}
    for place, name in (((1.0, 1.0), "above"), ((-1.0, -1.0), "below")):
        ratio = at(*place)[:3] / np.maximum(hue[name], 1e-9)
        assert at(*place)[3] == 1
        assert np.ptp(ratio[hue[name] > 0]) < 1e-6 and 0.7 < ratio[hue[name] > 0][0] <= 1
    assert picture[0, 0, 3] == 0
    heights = {-0.05: view.depth[np.isfinite(view.depth)].max(), -1.05: view.depth.min()}
    assert all(depth == pytest.approx(height, abs=1e-5) for height, depth in heights.items())
