"""Uneven relay walls and clutter before them; `test_rooms.py` holds their rooms to the laws of rooms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from room_laws import object_names
from scipy import stats
from scipy.special import ndtri

import datagen as dg
from datagen.config import DatasetConfig, config_from_mapping
from datagen.labels import make_labels
from datagen.records import Scene
from scene_library.relief import bumpy

KINDS = ("curved", "corrugated", "bumpy", "stepped")


def configured(layout: str = "l_corridor", relay: dict[str, Any] | None = None, **more: Any) -> DatasetConfig:
    walls = {"kind": layout} | ({} if relay is None else {"relay_wall": relay})
    return config_from_mapping({"scene": {"layout": walls}, **more})


def part(scene: Scene, name: str) -> np.ndarray:
    return scene.corners[scene.faces_of(name)].reshape(-1, 3)


@pytest.mark.parametrize("kind", KINDS)
def test_relief_lies_behind_the_plane_and_covers_it_once(kind: str) -> None:
    """As deep as declared; a height field covers every point once: projected areas add up to the rectangle's."""
    relay = {"kind": kind, "relief_m": 0.12, "length_m": 0.4, "max_triangles": 6000}
    scene, flat = (dg.generate_scene(configured("t_corridor", of).scene, 0, 1) for of in (relay, None))
    depth = part(scene, "relay_wall")[:, 0] - scene.relay_wall.center[0]
    assert depth.min() == 0
    assert 0.08 < depth.max() < 0.12 + 1e-12
    assert len(scene.faces_of("relay_wall")) <= 6000
    for end in (np.min, np.max):
        np.testing.assert_array_equal(*(end(part(of, "relay_wall"), axis=0)[1:] for of in (scene, flat)))
    assert scene.parameters["relay_wall.relief_m"] == 0.12
    t = scene.corners[scene.faces_of("relay_wall")]
    projected = 0.5 * np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0])[:, 0]
    assert (np.abs(projected) > 0).all() and (np.sign(projected) == np.sign(projected[0])).all()
    assert abs(projected.sum()) == pytest.approx(np.prod(np.ptp(t.reshape(-1, 3), axis=0)[1:]), rel=1e-9)


def test_bumps_have_the_declared_correlation_and_depths() -> None:
    """Depths are uniform (Kolmogorov and Smirnov, level 10⁻³); the field behind them correlates as exp(−r²/2ℓ²)."""
    places = np.array([1.0, 1.4, 1.8])
    drawn = np.array(
        [bumpy(4.0, 3.0, 0.4, 10**6, np.random.default_rng(k)).shape(places, 0 * places + 1.5) for k in range(600)]
    )
    assert stats.kstest(drawn[:, 0], "uniform").pvalue > 1e-3
    field = ndtri(drawn)
    for lag, expected in ((1, np.exp(-0.5)), (2, np.exp(-2.0))):
        found = np.corrcoef(field[:, 0], field[:, lag])[0, 1]
        assert np.arctanh(found) == pytest.approx(np.arctanh(expected), abs=4 / np.sqrt(600))


def test_clutter_stands_before_the_visible_wall_and_labels_look_through_it() -> None:
    relay = {"kind": "flat", "clutter": {"count": 3, "reach_m": 0.2, "width_m": 0.2}}
    config = configured("corridor_room", relay)
    kinds = set()
    for index in range(5):
        scene = dg.generate_scene(config.scene, 1, index)
        names = [n for n in scene.part_names if n.startswith("clutter_")]
        assert len(names) == 3
        kinds |= {n.split("_")[1] for n in names}
        for name in names:
            before = scene.relay_wall.center[0] - part(scene, name)[:, 0]
            assert before.min() >= 0.0099
            assert before.max() == pytest.approx(0.21)
            assert f"{name}.albedo" in scene.parameters
        seen = np.unique(make_labels(config.labels, scene, ("part_id",))["part_id"])
        assert all(scene.roles[k] != "relay_wall" for k in seen if k >= 0)
        assert len(object_names(scene)) == 2
    assert kinds == {"pillar", "pipe", "frame", "shelf"}


def test_labels_keep_to_the_nominal_plane() -> None:
    """Of two rooms that differ by their relay wall alone all labels are the same."""
    room = {
        "turn": "left", "relay_distance_m": 4, "height_m": 2.5, "device_height_m": 1, "device_offset": 0.5,
        "corridor_width_m": 2, "corridor_behind_m": 1, "room_length_m": 2.5, "room_width_m": 2.5,
    }  # fmt: skip
    box = {"kind": "box", "width_m": 0.4, "depth_m": 0.4, "height_m": 1, "along": 0.3, "across": 0.7, "albedo": 0.5}
    same = {name: {"albedo": 0.7} for name in ("relay_wall", "walls", "floor", "ceiling")}
    fields = ("depth", "normal", "albedo", "part_id", "shaded", "occupancy", "objects")
    made = []
    for kind in ("flat", "corrugated"):
        layout = {"kind": "l_corridor", **room, "relay_wall": {"kind": kind, "relief_m": 0.2, "length_m": 0.3}}
        scene = {"layout": layout, "contents": [{**box, "rotation_deg": 20}], "materials": same}
        config = config_from_mapping({"scene": scene})
        made.append(make_labels(config.labels, dg.generate_scene(config.scene, 0, 0), fields))
    for name, values in made[0].items():
        np.testing.assert_array_equal(values, made[1][name])
