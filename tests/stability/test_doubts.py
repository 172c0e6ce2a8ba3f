"""Scenes that are too large for their light, and devices that shut it in, get a line; ordinary scenes get none."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from rooms import rectangle

import datagen as dg
from datagen.errors import InputWarning
from datagen.transport.doubts import doubts
from datagen.transport.rays import Raycaster

DEVICE = (1.5, 3.0, 1.5)
ACCURACY = dg.Accuracy(target=0.1, max_bounces=3)


def box(middle: tuple[float, float, float], *sides: float) -> trimesh.Trimesh:
    return trimesh.creation.box(sides, trimesh.transformations.translation_matrix(middle))


WALL = dg.Part("wall", box((0, -0.01, 1.2), 2.4, 0.02, 2.4), dg.Lambertian(0.9), "relay_wall")
BALL = dg.Part("ball", trimesh.creation.icosphere(2, 0.25).apply_translation((0, 0.9, 1.9)), dg.Lambertian(0.6))
BENCH = (WALL, BALL)


def scan(device: tuple[float, float, float] = DEVICE) -> dg.Capture:
    sensor = dg.Sensor.grid(device, center=(0, 0, 0.8), right=(-0.4, 0, 0), up=(0, 0, 0.4), rows=2, columns=2)
    laser = dg.Laser(device, targets=sensor.pixels.mean(axis=1))
    return dg.Capture(laser, sensor, dg.TimeAxis(bins=128, width_s=1e-10, origin="wall"), pairing="confocal")


def ground(half_m: float) -> dg.Part:
    plane = rectangle((0, 0, 0), (half_m, 0, 0), (0, half_m, 0))
    return dg.Part("ground", plane, dg.Lambertian(0.3), "structure")


def bird(away_m: float) -> dg.Part:
    return dg.Part("bird", box((0, away_m, 50), 0.3, 0.3, 0.3), dg.Lambertian(0.3))


def lines(scene: dg.Scene, capture: dg.Capture, direct: bool = False) -> list[str]:
    return list(doubts(scene, capture, Raycaster(scene), direct))


def simulated(scene: dg.Scene, capture: dg.Capture) -> tuple[dg.Transient, list[str]]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = dg.simulate(scene, capture, ACCURACY, seed=0)
    return found, [str(one.message) for one in caught if issubclass(one.category, InputWarning)]


def test_light_over_a_growing_ground_plane_is_the_same_or_there_is_a_line() -> None:
    """The claim is never below what rays can know."""
    plain = dg.simulate(dg.Scene.from_parts([*BENCH, ground(3)]), scan(), ACCURACY, seed=0).parts["ball"].sum()
    for half_m in (300.0, 3e5):
        found, said = simulated(dg.Scene.from_parts([*BENCH, ground(half_m)]), scan())
        if said:
            assert any("'ground' is" in line and "cut the scene to" in line for line in said)
            assert found.relative_error > 0.1
        else:
            assert found.parts["ball"].sum() == pytest.approx(plain, rel=0.1)
    for half_m, warned in ((1e4, True), (3e4, True), (3e6, True), (30.0, False), (1e3, False)):
        assert bool(lines(dg.Scene.from_parts([*BENCH, ground(half_m)]), scan())) == warned


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e2])
@pytest.mark.parametrize("shift", [(0, 0, 0), (6e3, -8e3, 3.0)])
def test_whatever_stretches_a_scene_is_named_at_every_scale_and_place(
    scale: float, shift: tuple[float, float, float]
) -> None:
    def placed(*parts: dg.Part) -> tuple[dg.Scene, dg.Capture]:
        scene, capture, by = dg.Scene.from_parts(parts), scan(), np.array(shift)
        at = [one * scale + by for one in (capture.laser.position, capture.laser.targets, capture.sensor.pixels)]
        time = replace(capture.time, width_s=capture.time.width_s * scale)
        devices = dg.Laser(at[0], at[1]), dg.Sensor(at[0], at[2])
        moved = replace(capture, laser=devices[0], sensor=devices[1], time=time)
        return replace(scene, vertices=scene.vertices * scale + by), moved

    assert lines(*placed(*BENCH, ground(30.0), bird(100.0))) == []
    far, wide = (lines(*placed(*BENCH, more)) for more in (bird(1e5), ground(1e5)))
    assert len(far) == 1 and "m apart" in far[0]
    assert len(wide) == 1 and "'ground'" in wide[0]


@pytest.mark.parametrize("half_m", [1e-3, 0.2])
def test_no_claim_is_below_what_rays_of_single_precision_know(half_m: float) -> None:
    """A small patch before the wall, alone: replicates agree in all digits but a few. With a bird far away a claim
    says what that costs, and a line does."""
    patch = dg.Part("patch", rectangle((0, 1.2, 0.8), (half_m, 0, 0), (0, 0, half_m)), dg.Lambertian(0.6))
    found, said = simulated(dg.Scene.from_parts([WALL, patch]), scan())
    assert not said and found.total.any()
    assert found.relative_error >= 1e-6 and min(found.part_errors.values()) >= 1e-6
    found, said = simulated(dg.Scene.from_parts([WALL, patch, bird(1e5)]), scan())
    assert "m apart" in said[0] and found.relative_error >= 0.05


def test_one_mesh_of_everything_is_no_excuse() -> None:
    """A bench and its ground in one part: no part is small."""
    everything = trimesh.util.concatenate([WALL.mesh, BALL.mesh, ground(1e5).mesh])
    scene = dg.Scene.from_parts([dg.Part("all", everything, dg.Lambertian(0.5), "relay_wall")])
    assert any("rays start" in line for line in lines(scene, scan()))


def room(*more: dg.Part, thick_m: float = 0.2) -> dg.Scene:
    """A closed room of slabs about bench and device, as one part."""
    inner, t = np.array([(-2.0, 0.0, 0.0), (2.0, 4.0, 2.5)]), thick_m
    slabs = []
    for axis in range(3):
        for side in range(2):
            low, high = inner[0] - t, inner[1] + t
            low[axis], high[axis] = (
                (inner[0][axis] - t, inner[0][axis]) if side == 0 else (inner[1][axis], high[axis])
            )
            slabs.append(trimesh.creation.box(bounds=[low, high]))
    shell = dg.Part("room", trimesh.util.concatenate(slabs), dg.Lambertian(0.7), "structure")
    return dg.Scene.from_parts([shell, BALL, *more])


def test_a_device_inside_of_a_wall_gets_a_line() -> None:
    inside = (0.5, 4.1, 1.2)
    (line,) = lines(room(), scan(inside), direct=True)
    assert line.startswith("Laser.position = (0.5, 4.1, 1.2) lies inside of the part 'room'")
    split = replace(scan(), sensor=replace_position(scan(), inside))
    (line,) = lines(room(), split)
    assert line.startswith("Sensor.position")
    _, said = simulated(room(), scan(inside))
    assert any("lies inside of the part 'room'" in one for one in said)


def replace_position(capture: dg.Capture, position: tuple[float, float, float]) -> dg.Sensor:
    return dg.Sensor(position, capture.sensor.pixels)


def test_a_device_that_no_light_comes_back_to_gets_a_line() -> None:
    scene = dg.Scene.from_parts(BENCH)
    behind = (0.3, -3.0, 1.2)
    (line,) = lines(scene, replace(scan(), sensor=replace_position(scan(), behind)))
    assert "before the surfaces that the pixels see" in line and "Sensor.position" in line
    assert all("put " in one for one in lines(scene, scan(behind))) and len(lines(scene, scan(behind))) == 2
    # Outside of a room that stands alone.
    assert any("before the laser points" in one for one in lines(room(), scan((0.0, 9.0, 1.2))))
    past = dg.Sensor(DEVICE, scan().sensor.pixels + np.array([0, 0, 50.0]))
    assert any("no pixel sees a surface" in one for one in lines(scene, replace(scan(), sensor=past)))
    # Of one pixel the middle looks past the wall, and a quarter at it.
    over = dg.Sensor(DEVICE, [[(1.5, 0, 1), (1.0, 0, 1), (1.0, 0, 2), (1.5, 0, 2)]])
    assert lines(scene, replace(scan(), sensor=over, pairing="exhaustive")) == []


def test_devices_in_rooms_and_on_faces_get_no_line() -> None:
    shell = dg.Part("shell", box((0, 2, 1.25), 4, 4.0, 2.5), dg.Lambertian(0.7), "structure")
    assert lines(dg.Scene.from_parts([shell, BALL]), scan()) == []
    assert lines(dg.Scene.from_parts([shell]), scan()) == []
    assert lines(room(), scan()) == []
    # A device on the face of its mount, a closed plate, and one a micrometre off it.
    mount = dg.Part("mount", box((1.5, 3.005, 1.5), 0.1, 0.01, 0.1), dg.Lambertian(0.5), "structure")
    assert lines(room(mount), scan((1.5, 3.0 - 1e-6, 1.5))) == []
    assert "a millimetre off any surface" in lines(room(mount), scan(DEVICE))[0]
    # A laser point at an edge: half of the light goes no further than the wall beside it.
    corner = scan()
    edge = np.array([(1.9999, 0.0, 1.0)] * 4)
    assert lines(room(), replace(corner, laser=dg.Laser(DEVICE, edge))) == []
