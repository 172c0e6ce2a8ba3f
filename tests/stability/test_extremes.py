"""The rest of the hard cases, each against a limit, a closed form, or a rescaled or shifted copy."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hard_case_light import WALL, energy, moved, relative_l1
from rooms import bins_of_path, furnished_box, one_point_capture, rectangle

from datagen import (
    GGX,
    Accuracy,
    Capture,
    Lambertian,
    Laser,
    OrenNayar,
    Part,
    Phong,
    Retroreflector,
    Scene,
    Sensor,
    SinLobe,
    capture_for,
    generate_scene,
    load_config,
    simulate,
)

ROOM = Path(__file__).parents[2] / "configs" / "demonstration_room.yaml"
GLOSSY = (Lambertian(0.7), Phong(0.6, 20.0, 0.5), OrenNayar(0.8), GGX(0.7, 0.5, 0.3), Retroreflector(0.9, 0.1, 0.5),
          SinLobe(0.5))  # fmt: skip


@pytest.mark.parametrize(("scale", "shift"), [(250.0, (0, 0, 0)), (0.025, (6e3, -8e3, 3.0))])
@pytest.mark.parametrize("way", ["walk", "factorised", "glossy", "all_orders"])
def test_the_same_light_at_every_scale_and_place(way: str, scale: float, shift: tuple[float, ...]) -> None:
    """Rooms of 0.1 m and 1 km, and one of 0.1 m 10 km away: energy × s⁻², every component and BRDF to 10⁻⁴.

    Bounces after the secondary are compared in their sum: a thousandth of a degree turns a path at an edge.
    """
    scene = furnished_box()
    if way == "glossy":
        scene = replace(scene, materials=GLOSSY)
    capture = one_point_capture(time=bins_of_path(400, 0.05, 0.0))
    orders = None if way == "all_orders" else 4
    accuracy = Accuracy(2048, 4, orders, 4, direct=True, observed=16 if way == "factorised" else None)
    plain = simulate(scene, capture, accuracy, seed=1)
    other = simulate(*moved(scene, capture, scale, shift), accuracy, seed=1)
    for name, values in plain.components.items():
        found = other.components[name] * scale**2
        if not values.any():
            assert not found.any(), name
        elif name == "higher":
            assert found.sum() == pytest.approx(values.sum(), rel=1e-4)
        else:
            assert relative_l1(found, values) < 1e-4, name


def test_a_pixel_across_an_edge_is_the_sum_of_its_halves() -> None:
    """A field of view that falls half on a screen, half on the wall behind it, and partly on nothing."""
    screen = Part("screen", rectangle((0.5, 0.4, 0), (0, 0.4, 0), (0, 0, 3)), Lambertian(0.5))
    plate = Part("plate", rectangle((2, 0, 0), (0, 1, 0), (0, 0, 1)), Lambertian(0.6))
    scene = Scene.from_parts([WALL, screen, plate])
    eye = np.array([1.2, -0.5, 0.1])

    def of(low: float, high: float) -> float:
        corners = np.array([[0, low, 1.8], [0, high, 1.8], [0, high, 2.2], [0, low, 2.2]])
        capture = Capture(Laser(eye, [[0, -0.6, 0]]), Sensor(eye, [corners]), bins_of_path(1, 50.0, 0.0))
        return energy(simulate(scene, capture, Accuracy(1 << 14, 16, 3, 4), seed=1))

    halves = of(-0.4, 0.1) + of(0.1, 0.6)
    assert halves > 0
    assert of(-0.4, 0.6) == pytest.approx(halves, rel=5e-3)


def test_light_that_never_fades_keeps_its_weight() -> None:
    """All orders in a white room: a path that bounces to and fro in a corner must not come out of it with a weight
    that grew at every bounce, as it does where a constant survival ends paths. Then some seeds err far more."""
    config = load_config(ROOM)
    room = generate_scene(config.scene, config.seed, 0)
    capture = capture_for(config, room)
    accuracy = Accuracy(4096, 4, None, 8)
    errors = [simulate(room, capture, accuracy, seed=seed, split_parts=False).relative_error for seed in range(8)]
    assert max(errors) < 1.1 * np.median(errors)
