"""The key `brdf`: every kind reaches the scene, with numbers as declared."""

from __future__ import annotations

import math

import pytest

from datagen import generate_scene
from datagen.config import config_from_mapping
from datagen.records import GGX, Lambertian, Material, OrenNayar, Phong, Retroreflector, SinLobe


def box_material(**box: object) -> Material:
    config = config_from_mapping({"scene": {"contents": [{"kind": "box", **box}]}})
    scene = generate_scene(config.scene, seed=1, index=0)
    material = scene.materials[scene.part_names.index("box")]
    assert scene.parameters["box.albedo"] == material.albedo
    return material


@pytest.mark.parametrize(
    ("brdf", "model"),
    [
        ({"kind": "lambertian"}, Lambertian),
        ({"kind": "sin_lobe"}, SinLobe),
        ({"kind": "phong", "exponent": {"log_uniform": [5, 100]}, "specular": 0.4}, Phong),
        ({"kind": "oren_nayar", "sigma_deg": {"uniform": [10, 30]}}, OrenNayar),
        ({"kind": "ggx", "roughness": {"uniform": [0.2, 0.5]}, "f0": 0.04}, GGX),
        ({"kind": "retroreflector", "half_width_deg": 1.0, "retro": 0.8}, Retroreflector),
    ],
)
def test_each_kind_reaches_the_scene(brdf: dict, model: type[Material]) -> None:
    material = box_material(albedo=0.6, brdf=brdf)
    assert type(material) is model
    assert material.albedo == 0.6
    if isinstance(material, Phong):
        assert 5 <= material.exponent <= 100
        assert material.specular == 0.4
    if isinstance(material, OrenNayar):
        assert math.radians(10) <= material.sigma_rad <= math.radians(30)
    if isinstance(material, Retroreflector):
        assert material.half_width_rad == pytest.approx(math.radians(1.0))


def test_catalogue_lobes_follow_the_drawn_material() -> None:
    assert isinstance(box_material(material=["concrete"], brdf={"kind": "catalogue"}), Lambertian)
    glossy = box_material(material=["white_painted_plaster"], brdf={"kind": "catalogue"})
    assert isinstance(glossy, Phong)
    assert (glossy.specular, glossy.exponent) == (0.02, 10.0)
    assert isinstance(box_material(material=["white_painted_plaster"]), Lambertian)
