"""Settings that cannot be met: one line that names the key, the value and the remedy."""

from __future__ import annotations

from typing import Any

import pytest

from datagen.config import config_from_mapping
from datagen.errors import InputError
from datagen.scene import generate_scene


def box(**keys: Any) -> dict[str, Any]:
    return {"contents": [{"kind": "box", **keys}]}


def room(**keys: Any) -> dict[str, Any]:
    return {"layout": {"kind": "l_corridor", **keys}}


def walls(**keys: Any) -> dict[str, Any]:
    return {"materials": {"walls": keys}}


WHEN_READ: list[tuple[dict[str, Any], str]] = [
    ({"contents": [{"kind": "pilar"}]}, "scene.contents[0]: kind = 'pilar' is unknown; did you mean 'pillar'?"),
    (
        {"contents": [{"width_m": 1}]},
        "a mapping is needed with the key kind, one of pillar, box",
    ),
    ({"contents": ["box"]}, "scene.contents[0] = 'box': a mapping is needed with the key kind"),
    (
        {"contents": [{"kind": "library", "classes": ["chiar"]}]},
        "classes: 'chiar' is not a class of the library; did",
    ),
    (box(widht_m=1), "scene.contents[0].widht_m: unknown key"),
    (box(albedo=-0.1), "scene.contents[0].albedo: -0.1 given; must be ≥ 0 and ≤ 1"),
    (box(albedo=1.5), "scene.contents[0].albedo: 1.5 given; must be ≥ 0 and ≤ 1"),
    (box(width_m={"uniform": [2, 1]}), "scene.contents[0].width_m: uniform = [2, 1]: the range is upside down"),
    (box(width_m="wide"), "scene.contents[0].width_m = 'wide': a number is needed"),
    (box(width_m=0), "scene.contents[0].width_m: 0 given; must be > 0"),
    (box(count=1.5), "scene.contents[0].count: 1.5 given; whole numbers"),
    (box(name="walls"), "scene.contents[0]: name = 'walls': is a part of the room"),
    (box(brdf={"kind": "phon"}), "did you mean 'phong'"),
    (box(brdf={"kind": "phong", "exponnent": 3}), "did you mean 'exponent'"),
    (box(brdf={"kind": "phong", "exponent": -1}), "exponent: -1 given; must be"),
    (box(brdf={"kind": "ggx", "roughness": {"uniform": [0.05, 0.5]}}), "must be ≥ 0.1"),
    (box(brdf={"kind": "catalogue"}), "name one under material"),
    (walls(albedo={"uniform": [0.5, 1.2]}), "scene.materials.walls.albedo: 0.5 … 1.2 given"),
    (walls(material=["pine"]), "walls.material: 'pine' is not a material of the catalogue; did"),
    (walls(material=["concrete"], albedo=0.5), "albedo and material are both given"),
    (room(room_lenght_m=3), "did you mean 'room_length_m'?"),
    (room(relay_wall={"kind": "curved", "relief_m": 2}), "relief_m: 2 given; must be"),
    (room(relay_wall={"kind": "wavy"}), "relay_wall.kind = 'wavy'"),
    ({"max_attempts": 0}, "scene.max_attempts = 0"),
    (
        {"wavelength_nm": 531.9},
        "scene.wavelength_nm: 531.9 nm given, and the catalogue of materials covers 532",
    ),
    ({"wavelength_nm": 1551}, "scene.wavelength_nm: 1551 nm given"),
]


@pytest.mark.parametrize(("scene", "words"), WHEN_READ)
def test_refused_when_read(scene: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError) as error:
        config_from_mapping({"scene": scene}, "rooms.yaml")
    assert str(error.value).startswith("rooms.yaml: ")
    assert words in str(error.value)
    assert "\n" not in str(error.value)


BOX = {"width_m": 0.3, "depth_m": 0.3, "height_m": 0.5}
SHIELD = {"kind": "pillar", "name": "shield", "width_m": 2.996, "depth_m": 0.1, "along": 0.5, "across": 0.6,
          "rotation_deg": 0}  # fmt: skip
BEHIND = {"kind": "box", "across": 0.9, "along": 0.5, "width_m": 0.1, "depth_m": 0.1, "height_m": 0.5}
WHEN_DRAWN: list[tuple[dict[str, Any], list[str]]] = [
    (
        {"contents": [{"kind": "pillar", "width_m": 9}]},
        ["20 × scene.contents[0] (pillar) did not fit between the walls", "lower scene.contents[0].width_m (9)"],
    ),
    (
        {"contents": [{"kind": "box", "height_m": 9}]},
        [
            "20 × scene.contents[0] (box) did not fit between floor and ceiling",
            "lower scene.contents[0].height_m (9)",
        ],
    ),
    (
        {"layout": {"kind": "l_corridor", "room_length_m": 9}},
        [
            "20 × scene.layout: the corner that hides the rest lies behind the device",
            "raise relay_distance_m (5 … 7) or lower room_length_m (9)",
        ],
    ),
    (
        {"layout": {"kind": "l_corridor", "height_m": 0.5}},
        ["20 × scene.layout: the device is above the ceiling: lower device_height_m (0.8 … 1.6) or raise height_m"],
    ),
    (
        {"contents": [{"kind": "pillar", "width_m": 3.0, "rotation_deg": 45}]},
        ["20 × scene.contents[0] (pillar) did not fit between the walls", "lower scene.contents[0].width_m (3)"],
    ),
    (
        box(width_m=0.5, depth_m=0.5, height_m=0.5, count=30) | room(room_length_m=3.0, room_width_m=3.0),
        ["had no place beside the other objects", "scene.contents[0].count (30)", "scene.clearance_m (0.02)"],
    ),
    (
        box(**BOX, across=0.1, along=0.9) | room(room_length_m=2.5),
        ["20 × scene.contents[0] (box) stood in sight of the device", "change scene.contents[0].across (0.1)"],
    ),
    (
        box(**BOX | {"height_m": 2.0}, elevation_m=2.5),
        ["20 × scene.contents[0] (box) did not fit between floor and ceiling", "scene.layout.height_m (2.4 … 3.2)"],
    ),
    (
        {"contents": [SHIELD, BEHIND], "clearance_m": 0.001} | room(room_length_m=3, room_width_m=5, height_m=2.5),
        ["20 × scene.contents[1] (box) could hardly be seen from the visible part of the relay wall"],
    ),
    (
        room(room_length_m=6.95, relay_distance_m=7.0),
        ["the corner that hides the rest lies within 0.1 m of the device", "raise relay_distance_m"],
    ),
    (
        box(placement="wall") | {"layout": {"kind": "isolated_wall"}},
        ["found no wall to stand against: set its placement to floor"],
    ),
    (
        room(relay_wall={"kind": "bumpy", "length_m": 0.02, "max_triangles": 200}),
        ["scene.layout: relay_wall.max_triangles = 200: bumps of 0.02 m need"],
    ),
    (
        room(relay_wall={"clutter": {"count": 40, "width_m": 0.5}}),
        ["relay_wall.clutter", "lower its count, width_m or reach"],
    ),
    (
        box(width_m=0.2, distance_m=0.25)
        | {"layout": {"kind": "isolated_wall", "place": "in_front", "relay_distance_m": 0.4}},
        ["scene.contents[0].across", "or distance_m (0.25)"],
    ),
]


@pytest.mark.parametrize(("scene", "words"), WHEN_DRAWN)
def test_given_up_with_the_reason(scene: dict[str, Any], words: list[str]) -> None:
    spec = config_from_mapping({"scene": {"max_attempts": 20, **scene}}).scene
    with pytest.raises(InputError) as error:
        generate_scene(spec, 7, 3)
    message = str(error.value)
    assert message.startswith("scene 3 (seed 7): no room met the constraints in 20 attempts (scene.max_attempts): ")
    assert all(part in message for part in words), message
    assert "\n" not in message


def test_a_range_that_is_partly_possible_is_met_by_trying_again() -> None:
    spec = config_from_mapping({"scene": {**room(room_length_m={"uniform": [4.0, 9.0]}), "max_attempts": 200}}).scene
    assert max(generate_scene(spec, 0, i).parameters["draws"] for i in range(6)) > 1
