"""A corrugated relay wall changes the transient; the change falls with the depth of the ridges, and a level wall has
none."""

from __future__ import annotations

from typing import Any

import numpy as np

import datagen as dg
from datagen.config import config_from_mapping
from datagen.records import Transient

ROOM: dict[str, Any] = {
    "kind": "l_corridor", "turn": "left", "relay_distance_m": 4, "height_m": 2.5, "device_height_m": 1,
    "device_offset": 0.5, "corridor_width_m": 2, "corridor_behind_m": 1, "room_length_m": 2.5, "room_width_m": 2.5,
}  # fmt: skip
BOX = {"kind": "box", "width_m": 0.4, "depth_m": 0.4, "height_m": 1, "along": 0.3, "across": 0.7, "rotation_deg": 0}
PLAIN = {name: {"albedo": 0.7} for name in ("relay_wall", "walls", "floor", "ceiling")}


def transient(relay: dict[str, Any]) -> Transient:
    """The transient of a room whose draws, except for the ridges' phase, are constants, so that rooms differ by their
    relay wall alone."""
    room = ROOM | {"relay_wall": relay}
    config = config_from_mapping(
        {
            "scene": {"layout": room, "contents": [BOX | {"albedo": 0.8}], "materials": PLAIN},
            "capture": {
                "pairing": "exhaustive", "scan": {"rows": 1, "columns": 2, "width_m": 0.7},
                "field_of_view": {"rows": 2, "columns": 2, "width_m": 1.0, "height_m": 1.0},
                "time": {"bins": 128, "bin_width_ps": 200},
            },
        }
    )  # fmt: skip
    scene = dg.generate_scene(config.scene, 0, 0)
    return dg.simulate(scene, dg.capture_for(config, scene), dg.Accuracy(samples=8192), seed=5)


def ribs(relief_m: float) -> dict[str, Any]:
    return {"kind": "corrugated", "relief_m": relief_m, "length_m": 0.25}


def test_a_corrugated_wall_differs_from_a_flat_one_and_tends_to_it() -> None:
    flat = transient({"kind": "flat"}).total
    away = [
        float(np.linalg.norm(transient(ribs(relief)).total - flat) / np.linalg.norm(flat))
        for relief in (0.16, 0.04, 0.01, 1e-6)
    ]
    assert away[0] > 0.1
    assert away[0] > away[1] > away[2] > away[3]
    assert away[3] < 0.06


def test_ridges_light_each_other() -> None:
    """Only a wall that is not flat scatters light to itself in three bounces."""
    for relay, lit in (({"kind": "flat"}, False), (ribs(0.16), True)):
        own = transient(relay).parts["relay_wall"]
        assert (own.sum() > 0) == lit
