"""The material catalogue, the samples that it was taken from, and how settings draw from it."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

from datagen.config import config_from_mapping
from datagen.errors import InputError
from datagen.records import Lambertian, Phong
from datagen.scene import generate_scene
from scene_library.materials import MATERIALS
from scene_library.reflectances import OPTICAL_CONSTANTS, SAMPLES, WAVELENGTHS_NM, OpticalConstants

LIBRARIES = Path(__file__).parents[3] / "shared" / "real" / "reflectances.csv"
METALS = {"Al": "aluminum", "Cu": "copper", "Au": "gold", "Ag": "silver", "Ni": "nickel"}


def spectrum(name: str) -> dict[float, float]:
    """Reflectance of a material of the catalogue by wavelength in nm."""
    return dict(zip(WAVELENGTHS_NM, MATERIALS[name].reflectance, strict=True))


def test_every_row_is_complete_and_possible() -> None:
    assert len(MATERIALS) >= 60
    assert len({m.reasoning for m in MATERIALS.values()}) == len(MATERIALS)
    for name, material in MATERIALS.items():
        assert material.name == name
        assert len(material.reflectance) == len(material.spread) == len(WAVELENGTHS_NM)
        assert all(0 < r < 1 for r in material.reflectance)
        assert all(0 < s < 0.3 for s in material.spread)
        assert 0 <= material.brdf.specular + material.brdf.retro <= 1
        assert (material.brdf.exponent > 0) == (material.brdf.specular > 0)
        for wavelength, value in zip(WAVELENGTHS_NM, material.reflectance, strict=True):
            assert material.albedo(wavelength) == value
            for tint in (-1, 1):
                Lambertian(material.albedo(wavelength, tint))


def test_measured_materials_are_the_mean_of_their_samples_and_spread_over_their_range() -> None:
    assert sum(material.origin == "measured" for material in MATERIALS.values()) >= 30
    for material in MATERIALS.values():
        assert (material.origin == "measured") == bool(material.samples)
        if material.samples:
            values = np.array([SAMPLES[name].reflectance for name in material.samples])
            np.testing.assert_allclose(material.reflectance, values.mean(axis=0), atol=1e-12)
            if len(values) > 1:
                np.testing.assert_allclose(material.spread, np.ptp(values, axis=0) / 2, atol=1e-12)
    used = {name for material in MATERIALS.values() for name in material.samples}
    assert used == set(SAMPLES)


def test_samples_are_those_of_the_libraries() -> None:
    """Every quoted number is the library's, to its three decimals."""
    if not LIBRARIES.is_file():
        pytest.skip(f"{LIBRARIES.name}: not part of the repository; put it into shared/real beside the checkout")
    found: dict[str, tuple[str, tuple[float, ...]]] = {}
    with LIBRARIES.open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            metal = row["material"].removesuffix(", polished")
            name = f"NASA {metal}" if row["source"].startswith("NASA") else row["source"]
            values = tuple(float(row[f"r{wavelength:g}"]) for wavelength in WAVELENGTHS_NM)
            found[name] = row["material"].replace("aluminum", "aluminium"), values
    quoted = {name: sample for name, sample in SAMPLES.items() if not name.startswith("Fresnel")}
    assert len(quoted) == 41
    assert {name: (of.description, of.reflectance) for name, of in quoted.items()} == {
        name: found[name] for name in quoted
    }


def test_fresnel_reflectance_has_its_limits() -> None:
    """Glass reflects 4 %, air nothing, a perfect conductor everything."""
    everywhere = (0.0,) * len(WAVELENGTHS_NM)
    for n, k, expected in ((1.5, 0.0, 0.04), (1.0, 0.0, 0.0), (0.0, 3.0, 1.0), (1.0, 1e6, 1.0)):
        constants = OpticalConstants("", tuple(n for _ in everywhere), tuple(k for _ in everywhere))
        assert constants.reflectance() == pytest.approx([expected] * len(everywhere), abs=1e-9)


@pytest.mark.parametrize("metal", METALS)
def test_polished_metals_reflect_at_most_what_fresnels_equations_allow(metal: str) -> None:
    """An integrating sphere found polished sheets at most 0.02 brighter than clean, smooth metal (its own error), and
    darker by less than 0.15 at 532 nm, 0.11 at 670 nm and 0.085 from 850 nm on: roughness and oxide, which cost most
    at short wavelengths."""
    fresnel = np.array(OPTICAL_CONSTANTS[metal].reflectance())
    lost = fresnel - SAMPLES[f"NASA {METALS[metal]}"].reflectance
    assert lost.min() > -0.02
    assert (lost < [0.15, 0.11, 0.085, 0.085, 0.085, 0.085, 0.085]).all()


def test_known_physics_shows_in_the_numbers() -> None:
    """Red edge of leaves, water at 1550 nm, dyes that clear in the infrared, interband edges, iron oxide's slope."""
    for leaf in ("green_foliage", "green_grass", "conifer_leaves"):
        assert spectrum(leaf)[850] > 5 * spectrum(leaf)[670]
        assert spectrum(leaf)[1550] < 0.6 * spectrum(leaf)[1064]
    assert spectrum("fresh_snow")[1550] < 0.2 < 0.8 < spectrum("fresh_snow")[532]
    for skin in ("light_skin", "dark_skin"):
        assert spectrum(skin)[1550] < 0.2 * spectrum(skin)[905]
    assert spectrum("blue_denim")[905] > 4 * spectrum("blue_denim")[670]
    for copper in ("tarnished_copper", "polished_copper"):
        assert spectrum(copper)[532] < 0.65 * spectrum(copper)[670]
    assert min(spectrum("polished_aluminium"), key=spectrum("polished_aluminium").__getitem__) == 850
    for dry in ("dry_soil", "dry_sand", "red_brick"):
        assert list(spectrum(dry).values()) == sorted(spectrum(dry).values())
    brushed, clean = MATERIALS["brushed_aluminium"].reflectance, OPTICAL_CONSTANTS["Al"].reflectance()
    assert brushed == pytest.approx([0.8 * value for value in clean], abs=0.01)


def test_between_the_lines_and_outside() -> None:
    wood = MATERIALS["pine_wood"]
    assert wood.albedo(601.0) == pytest.approx((wood.reflectance[0] + wood.reflectance[1]) / 2)
    assert wood.albedo(532) == wood.reflectance[0]
    assert wood.albedo(1550) == wood.reflectance[-1]
    for outside in (531.9, 1550.1, float("nan")):
        with pytest.raises(ValueError, match="532 … 1550 nm"):
            wood.albedo(outside)


def test_the_spread_is_narrowed_at_0_and_1_on_both_sides() -> None:
    flat = (0.5,) * len(WAVELENGTHS_NM)
    for middle, spread in ((0.97, 0.03), (0.03, 0.03), (0.5, 0.2)):
        material = replace(
            MATERIALS["concrete"], reflectance=tuple(middle for _ in flat), spread=tuple(0.2 for _ in flat)
        )
        for tint in (-1, -0.5, 0, 1):
            assert material.albedo(940, tint) == pytest.approx(middle + tint * spread)


def catalogue_room(wavelength_nm: float) -> dict[str, Any]:
    shiny = {"brdf": {"kind": "catalogue"}}
    return {
        "layout": {"kind": "l_corridor"},
        "contents": [
            {"kind": "box", "material": ["polished_copper", "copper_patina", "green_foliage"], **shiny},
            {"kind": "pillar", "material": ["stainless_steel", "blue_denim"], **shiny},
        ],
        "materials": {
            "relay_wall": {"material": ["white_painted_plaster", "red_brick"]},
            "walls": {"material": ["concrete", "granite"]},
            "floor": {"material": ["dry_soil", "fresh_snow"]},
        },
        "wavelength_nm": wavelength_nm,
    }


def test_the_wavelength_changes_the_albedos_of_a_room_and_nothing_else() -> None:
    """The same seed at 532 and 940 nm: geometry, choice and tint of the materials and lobes stay, and every albedo is
    the catalogue's at its wavelength."""
    green, infrared = (config_from_mapping({"scene": catalogue_room(nm)}).scene for nm in (532, 940))
    lobes = set()
    for index in range(20):
        one, other = generate_scene(green, 7, index), generate_scene(infrared, 7, index)
        assert np.array_equal(one.triangles, other.triangles)
        for name, before, after in zip(one.part_names, one.materials, other.materials, strict=True):
            assert replace(before, albedo=0.5) == replace(after, albedo=0.5)
            key = f"{name}.material"
            assert one.parameters.get(key) == other.parameters.get(key)
            if key not in one.parameters:
                assert before == after
                continue
            material = MATERIALS[str(one.parameters[key])]
            lobes |= {type(before)} if material.samples else set()
            low, high = material.albedo(532, -1), material.albedo(532, 1)
            tint = 2 * (before.albedo - low) / (high - low) - 1
            assert -1 <= tint <= 1
            assert after.albedo == pytest.approx(material.albedo(940, tint), abs=1e-9)
            assert before.albedo != after.albedo
            assert other.parameters[f"{name}.albedo"] == after.albedo
    assert lobes == {Lambertian, Phong}


@pytest.mark.parametrize("wavelength_nm", [500, 531.9, 1551, 1600])
def test_a_wavelength_outside_the_catalogue_is_refused(wavelength_nm: float) -> None:
    with pytest.raises(InputError, match=r"scene\.wavelength_nm: .* covers 532 … 1550 nm; take a wavelength in that"):
        config_from_mapping({"scene": {"wavelength_nm": wavelength_nm}})


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
        middle, spread = MATERIALS[name].albedo(1550), MATERIALS[name].spread[-1]
        assert stats.kstest(albedos, stats.uniform(middle - spread, 2 * spread).cdf).pvalue > 5e-4
    assert stats.binomtest(len(drawn["pine_wood"]), 200).pvalue > 1e-3
