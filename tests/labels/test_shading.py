"""The shaded view against form factors known in closed form, and its shadows against geometry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from handmade_rooms import DISTANCE_M, HEIGHT_M, box_mesh, l_corridor, rectangle_mesh, wall_view

from datagen.config import LabelsConfig
from datagen.errors import InputError
from datagen.labels import make_labels
from datagen.labels.shading import AMBIENT_RADIANCE, form_factors
from datagen.records import Lambertian, Part, Rectangle, Scene

CONFIG = LabelsConfig(rows=24, columns=30)
LAMP = Rectangle.of((DISTANCE_M, 0, HEIGHT_M / 2), (0, -1, 0), (0, 0, HEIGHT_M / 2))


def lit_by_lamp(*objects: Part) -> Scene:
    relay = Part("relay_wall", rectangle_mesh(LAMP), Lambertian(0.8), "relay_wall")
    return Scene.from_parts([relay, *objects], relay_wall=LAMP, hidden_view=wall_view())


def brute_force(point: np.ndarray, normal: np.ndarray, n: int = 1500) -> float:
    """∫ cosθ cosθ′ / (π R²) dA over the lamp by the midpoint rule."""
    u = (np.arange(n) + 0.5) / n * 2 - 1
    across, up = np.meshgrid(u, u)
    on_lamp = LAMP.center + across[..., None] * LAMP.right + up[..., None] * LAMP.up
    toward = on_lamp - point
    square = (toward**2).sum(axis=-1)
    cosines = np.maximum(toward @ normal, 0) * np.maximum(-(toward @ LAMP.normal), 0)
    return float((cosines / (np.pi * square**2)).sum() * LAMP.area_m2 / n**2)


def test_form_factor_of_a_lamp_that_the_horizon_cuts() -> None:
    rng = np.random.default_rng(2)
    for _ in range(3):
        point = np.array([rng.uniform(3, 5.5), rng.uniform(-3, 3), rng.uniform(0, HEIGHT_M)])
        normal = rng.normal(size=3)
        normal /= np.linalg.norm(normal)
        found = form_factors(point[None], normal[None], LAMP.corners)[0]
        assert found == pytest.approx(brute_force(point, normal), abs=2e-6)


def test_enclosed_in_light_every_surface_shows_its_albedo() -> None:
    """A furnace: the six faces of a closed lamp add up to a form factor of 1 for any patch inside."""
    cube = box_mesh((2, 2, 2), (0, 0, 0))
    normals = np.random.default_rng(0).normal(size=(50, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    points = np.random.default_rng(1).uniform(-0.9, 0.9, (50, 3))
    total = sum(form_factors(points, normals, np.asarray(t)) for t in cube.triangles)
    np.testing.assert_allclose(total, 1, rtol=1e-10)


def test_front_of_a_box_has_the_radiance_of_its_form_factor() -> None:
    """In proportion to its albedo."""
    full, fine = (
        make_labels(CONFIG, lit_by_lamp(Part("box", box_mesh((0.6, 1.0, 0.8), (4.3, 3.0, 1.0)), Lambertian(albedo))),
                    ("shaded", "depth"))
        for albedo in (1.0, 0.4)
    )  # fmt: skip
    shaded = fine["shaded"]
    np.testing.assert_allclose(shaded, 0.4 * full["shaded"], rtol=1e-6)
    assert shaded.dtype == np.float32 and full["shaded"].max() <= 1
    np.testing.assert_array_equal(shaded > 0, fine["depth"] > 0)
    row, column = (int(i[len(i) // 2]) for i in np.nonzero(shaded))
    y = 4.0 - 3.0 * (column + 0.5) / 30
    z = HEIGHT_M * (1 - (row + 0.5) / 24)
    lit = brute_force(np.array([4.6, y, z]), np.array([1.0, 0, 0]))
    assert shaded[row, column] == pytest.approx(0.4 * (lit + (1 - lit) * AMBIENT_RADIANCE), rel=1e-5)


def test_shadow_falls_where_the_lamp_is_hidden_and_not_elsewhere() -> None:
    """A screen beside the lamp's edge hides all of it from some pixels (umbra), none from others."""
    plate = Part("plate", box_mesh((0.1, 3.0, HEIGHT_M), (3.0, 2.5, HEIGHT_M / 2)), Lambertian(0.5))
    screen = Part("screen", box_mesh((2.0, 0.01, HEIGHT_M), (5.0, 1.4, HEIGHT_M / 2)), Lambertian(0.5), "structure")
    open_scene, shadowed = lit_by_lamp(plate), lit_by_lamp(plate, screen)
    before, after = (make_labels(CONFIG, s, ("shaded", "part_id")) for s in (open_scene, shadowed))
    on_plate = (after["part_id"] == 1) & (before["part_id"] == 1)
    y = 4.0 - 3.0 * (np.arange(30) + 0.5) / 30
    # From (3.05, y): the screen 4 ≤ x ≤ 6 at y = 1.4 hides the lamp −1 ≤ y ≤ 1 at x = 6.
    least = y + (1.4 - y) * 2.95 / 0.95
    umbra, clear = (y > 1.45) & (least < -1), y < 1.35
    assert umbra.sum() >= 3 and clear.sum() >= 2
    np.testing.assert_allclose(after["shaded"][:, umbra][on_plate[:, umbra]], 0.5 * AMBIENT_RADIANCE, rtol=1e-5)
    same = on_plate & clear
    np.testing.assert_allclose(after["shaded"][same], before["shaded"][same], rtol=1e-5)
    part = on_plate & (after["shaded"] < before["shaded"] * 0.999)
    assert part.sum() > umbra.sum()


def test_a_scene_without_relay_wall_has_no_lamp() -> None:
    scene = replace(l_corridor(), relay_wall=None)
    with pytest.raises(InputError, match=r"'shaded'.*relay wall.*leave shaded out"):
        make_labels(CONFIG, scene, ("shaded",))
