"""The material catalogue, the samples that it was taken from, how settings draw from it, and the key `brdf`."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from every_brdf import KINDS
from scipy import stats

from datagen.config import config_from_mapping
from datagen.records import Lambertian, Material, Phong
from datagen.scene import generate_scene
from scene_library.materials import MATERIALS
from scene_library.reflectances import SAMPLES, WAVELENGTHS_NM, OpticalConstants

LIBRARIES = Path(__file__).parents[3] / "shared" / "real" / "reflectances.csv"


def test_every_row_is_possible_and_the_mean_of_its_samples() -> None:
    """Spread over their range; between the lines of the catalogue reflectance is linear, outside refused."""
    for name, material in MATERIALS.items():
        assert material.name == name
        assert len(material.reflectance) == len(material.spread) == len(WAVELENGTHS_NM)
        assert all(0 < r < 1 for r in material.reflectance)
        assert all(0 < s < 0.3 for s in material.spread)
        assert 0 <= material.brdf.specular + material.brdf.retro <= 1
        assert (material.brdf.exponent > 0) == (material.brdf.specular > 0)
        assert tuple(map(material.albedo, WAVELENGTHS_NM)) == material.reflectance
        assert (material.origin == "measured") == bool(material.samples)
        if material.samples:
            values = np.array([SAMPLES[name].reflectance for name in material.samples])
            np.testing.assert_allclose(material.reflectance, values.mean(axis=0), atol=1e-12)
            if len(values) > 1:
                np.testing.assert_allclose(material.spread, np.ptp(values, axis=0) / 2, atol=1e-12)
    assert {name for material in MATERIALS.values() for name in material.samples} == set(SAMPLES)
    wood = MATERIALS["pine_wood"]
    assert wood.albedo(601.0) == pytest.approx((wood.reflectance[0] + wood.reflectance[1]) / 2)
    for outside in (531.9, 1550.1, float("nan")):
        with pytest.raises(ValueError, match="532 … 1550 nm"):
            wood.albedo(outside)


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


def test_the_spread_is_narrowed_at_0_and_1_on_both_sides() -> None:
    for middle, spread in ((0.97, 0.03), (0.03, 0.03), (0.5, 0.2)):
        row = {"reflectance": (middle,) * len(WAVELENGTHS_NM), "spread": (0.2,) * len(WAVELENGTHS_NM)}
        for tint in (-1, -0.5, 0, 1):
            assert replace(MATERIALS["concrete"], **row).albedo(940, tint) == pytest.approx(middle + tint * spread)


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
    for index in range(10):
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


def box_of(scene: dict[str, Any], index: int = 0) -> tuple[Material, dict[str, Any]]:
    """The material of the box in a room, and the room's parameters."""
    room = generate_scene(config_from_mapping({"scene": scene}).scene, 0, index)
    material = room.materials[room.part_names.index("box")]
    assert room.parameters["box.albedo"] == material.albedo
    return material, dict(room.parameters)


def test_tints_are_even_over_the_spread() -> None:
    names = ["pine_wood", "light_skin"]
    scene = {"contents": [{"kind": "box", "material": names}], "wavelength_nm": 1550}
    drawn: dict[str, list[float]] = {n: [] for n in names}
    for index in range(50):
        material, parameters = box_of(scene, index)
        drawn[parameters["box.material"]].append(material.albedo)
    # Two tests of level 1e-3 / 2 and one of evenness.
    for name, albedos in drawn.items():
        middle, spread = MATERIALS[name].albedo(1550), MATERIALS[name].spread[-1]
        assert stats.kstest(albedos, stats.uniform(middle - spread, 2 * spread).cdf).pvalue > 5e-4
    assert stats.binomtest(len(drawn["pine_wood"]), 50).pvalue > 1e-3


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_of_brdf_reaches_the_scene(kind: str) -> None:
    due, keys = KINDS[kind].read
    assert box_of({"contents": [{"kind": "box", "albedo": 0.6, "brdf": {"kind": kind, **keys}}]})[0] == due


def test_lobes_of_the_catalogue_are_taken_where_they_are_asked_for() -> None:
    for brdf, lobe in (({}, Lambertian), ({"brdf": {"kind": "catalogue"}}, Phong)):
        assert type(box_of({"contents": [{"kind": "box", "material": ["white_painted_plaster"], **brdf}]})[0]) is lobe
