"""The material catalogue and how settings draw from it."""

from __future__ import annotations

import pytest
from scipy import stats

from datagen.config import config_from_mapping
from datagen.records import Lambertian
from datagen.scene import generate_scene
from scene_library.materials import MATERIALS, WAVELENGTHS_NM


def test_every_row_is_complete_and_possible() -> None:
    assert len(MATERIALS) >= 25
    assert len({m.reasoning for m in MATERIALS.values()}) == len(MATERIALS)
    for name, material in MATERIALS.items():
        assert material.name == name
        assert len(material.reflectance) == len(WAVELENGTHS_NM)
        assert all(0 < r < 1 for r in material.reflectance)
        assert 0 < material.spread < 0.3
        assert material.origin == "estimate"
        assert len(material.reasoning) > 40
        assert 0 <= material.brdf.specular + material.brdf.retro <= 1
        assert (material.brdf.exponent > 0) == (material.brdf.specular > 0)
        for wavelength, value in zip(WAVELENGTHS_NM, material.reflectance, strict=True):
            assert material.albedo(wavelength) == value
            for tint in (-1, 1):
                Lambertian(material.albedo(wavelength, tint))


def test_known_physics_shows_in_the_numbers() -> None:
    """Red edge of leaves, water at 1550 nm, dyes that clear in the infrared, copper's edge, iron oxide's slope."""
    at = {name: dict(zip(WAVELENGTHS_NM, m.reflectance, strict=True)) for name, m in MATERIALS.items()}
    assert at["green_foliage"][905] > 5 * at["green_foliage"][670]
    assert at["fresh_snow"][1550] < 0.2 < 0.8 < at["fresh_snow"][532]
    assert at["light_skin"][1550] < 0.2 * at["light_skin"][905]
    assert at["blue_denim"][905] > 4 * at["blue_denim"][670]
    assert at["tarnished_copper"][532] < at["tarnished_copper"][670]
    assert list(at["dry_soil"].values()) == sorted(at["dry_soil"].values())


def test_between_the_lines_and_outside() -> None:
    wood = MATERIALS["pine_wood"]
    assert wood.albedo(601.0) == pytest.approx((wood.reflectance[0] + wood.reflectance[1]) / 2)
    assert wood.albedo(500) == wood.reflectance[0]
    with pytest.raises(ValueError, match="500 … 1600"):
        wood.albedo(400)


def test_scenes_draw_materials_with_tints_inside_their_spread() -> None:
    names = ["pine_wood", "light_skin"]
    scene = {
        "contents": [{"kind": "box", "material": names}],
        "materials": {"floor": {"material": ["asphalt"]}},
        "wavelength_nm": 1550,
    }
    config = config_from_mapping({"scene": scene})
    drawn: dict[str, list[float]] = {n: [] for n in names}
    for index in range(200):
        scene_drawn = generate_scene(config.scene, 0, index)
        p = scene_drawn.parameters
        drawn[p["box.material"]].append(p["box.albedo"])
        assert p["floor.material"] == "asphalt"
        assert "walls.material" not in p
        assert scene_drawn.materials[scene_drawn.part_names.index("box")].albedo == p["box.albedo"]
    # Two tests of level 1e-3 / 2 and one of evenness.
    for name, albedos in drawn.items():
        middle, spread = MATERIALS[name].albedo(1550), MATERIALS[name].spread
        assert stats.kstest(albedos, stats.uniform(middle - spread, 2 * spread).cdf).pvalue > 5e-4
    assert stats.binomtest(len(drawn["pine_wood"]), 200).pvalue > 1e-3
