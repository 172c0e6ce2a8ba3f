"""The key `brdf`: every kind reaches the scene, with numbers as declared; mistakes are told in one line."""

from __future__ import annotations

import math

import pytest

from datagen import generate_scene
from datagen.config import config_from_mapping
from datagen.errors import InputError
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


@pytest.mark.parametrize(
    ("box", "words"),
    [
        ({"brdf": {"kind": "phon"}}, "did you mean 'phong'"),
        ({"brdf": {"kind": "phong", "exponnent": 3}}, "did you mean 'exponent'"),
        ({"brdf": {"kind": "phong", "exponent": -1}}, "must be"),
        ({"brdf": {"kind": "ggx", "roughness": {"uniform": [0.05, 0.5]}}}, "0.1"),
        ({"brdf": {"kind": "catalogue"}}, "name one under material"),
    ],
)
def test_mistakes_are_told_in_one_line(box: dict, words: str) -> None:
    with pytest.raises(InputError) as caught:
        box_material(**box)
    assert "scene.contents[0]" in str(caught.value)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
