"""Laws of the light that frames share: what stands once, and what moves for itself.

Statistical tests compare means over seeds with those of scenes that are simulated by themselves, at `SIGMAS` standard
errors; each test makes up to some fifty comparisons, so that one in a thousand runs fails by chance.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

import datagen as dg
from datagen.records import SequenceLight
from datagen.transport.sequences import light_of_sequence, times_of
from tests.sequences.rooms_that_move import box, capture, room

SIGMAS = 4.5
SLACK = 3e-3
"""Share of the energy that may be wrong: shadows of coarse cells are 0.6 % too dark."""
SHORT_S = 1e-6
"""An exposure in which nothing moves."""
FINE = dg.Accuracy(target=0.004)
ACCURACY = dg.Accuracy(target=0.02)
HALF_TURN = dg.Path((0.0, 1.0), [(1.5, 0.4, 1.2), (1.6, -0.5, 1.2)], (0, 140))
ACROSS = dg.Path((0.0, 1.0), [(1.2, 0.9, 0.5), (1.1, 0.1, 0.5)], (0, -60))


def person() -> trimesh.Trimesh:
    """A body, a head and two arms, 0.8 m high: no convex thing."""
    parts = [
        trimesh.creation.cylinder(0.15, 0.5, sections=12),
        trimesh.creation.icosphere(2, 0.12).apply_translation((0, 0, 0.4)),
        trimesh.creation.box((0.08, 0.5, 0.08)).apply_translation((0, 0, 0.15)),
    ]
    return trimesh.util.concatenate(parts)


def moving_box(material: dg.Material | None = None, path: dg.Path = HALF_TURN) -> dg.Part:
    return dg.Part("box", box(), material or dg.Lambertian(0.4), path=path)


def sequence(
    scene: dg.Scene, scan: dg.Capture, frames: int = 3, seed: int = 0, accuracy: dg.Accuracy = ACCURACY,
    exposure_s: float | None = SHORT_S,
) -> SequenceLight:  # fmt: skip
    clock = dg.Clock(frames, frames / 1.0, "together")
    return dg.simulate_sequence(scene, scan, clock, accuracy, seed, exposure_s=exposure_s)


LOW_BOX = dg.Part("other", box((0.3, 0.3, 0.4)), dg.Lambertian(0.7), path=ACROSS)
CASES = {
    "box": (room(moving_box()), "confocal"),
    "mesh": (room(dg.Part("person", person(), dg.Lambertian(0.2), path=HALF_TURN)), "confocal"),
    "dark": (room(moving_box(dg.Lambertian(0.05))), "confocal"),
    "glossy": (room(moving_box(dg.Phong(0.5, specular=0.5, exponent=20))), "confocal"),
    "glossy walls": (room(moving_box(), back=dg.Phong(0.5, specular=0.3, exponent=10)), "confocal"),
    "two": (room(moving_box(), LOW_BOX), "confocal"),
    "air": (room(moving_box(), attenuation_per_m=0.3), "confocal"),
    "behind a thing": (
        room(
            moving_box(),
            dg.Part("pillar", box((0.3, 0.3, 2.0)).apply_translation((0.8, 0.5, 1.2)), dg.Lambertian(0.5)),
        ),
        "confocal",
    ),
    "exhaustive": (room(moving_box()), "exhaustive"),
    "two, exhaustive": (room(moving_box(), LOW_BOX), "exhaustive"),
}


@pytest.mark.parametrize("case", CASES)
def test_energies_are_those_of_scenes_by_themselves(case: str) -> None:
    """Of each frame and part, over all histograms, and of the light of what stands alone, which shadows change."""
    scene, pairing = CASES[case]
    scan, seeds, frames = capture(pairing=pairing), 8, 3  # type: ignore[arg-type]
    lights = [sequence(scene, scan, frames, seed) for seed in range(seeds)]
    for f in range(frames):
        at = float(lights[0].times_s[f].mean())
        due = [dg.simulate(scene.at(at), scan, FINE, 100 + seed) for seed in range(3)]
        for name in [*scene.objects, None]:
            found = np.array([(light.total(f) if name is None else light.parts[name][f]).sum() for light in lights])
            wanted = np.array([(of.total if name is None else of.parts[name]).sum() for of in due])
            error = found.std(ddof=1) / seeds**0.5
            assert abs(found.mean() - wanted.mean()) <= SIGMAS * error + SLACK * wanted.mean(), (f, name)
        # The static room's own light with its shadow, which takes up to a third of it.
        gone = np.array([light.total(f).sum() - sum(of[f].sum() for of in light.parts.values()) for light in lights])
        left = np.array([of.total.sum() - sum(of.parts[name].sum() for name in scene.objects) for of in due])
        error = gone.std(ddof=1) / seeds**0.5
        assert abs(gone.mean() - left.mean()) <= SIGMAS * error + SLACK * left.mean(), f


@pytest.mark.parametrize("case", ["box", "exhaustive"])
def test_shapes_in_time_are_those_of_scenes_by_themselves(case: str) -> None:
    scene, pairing = CASES[case]
    scan, seeds = capture(pairing=pairing), 4  # type: ignore[arg-type]
    found = [sequence(scene, scan, 2, seed) for seed in range(seeds)]
    for f in range(2):
        at = float(found[0].times_s[f].mean())
        due = dg.simulate(scene.at(at), scan, FINE, 100).total
        errors = [np.linalg.norm(light.total(f) - due) / np.linalg.norm(due) for light in found]
        assert np.mean(errors) <= 1.5 * np.mean([light.relative_error[f] for light in found])


def test_what_stands_is_that_of_a_room_without_movers_in_all_frames() -> None:
    scene, scan = CASES["two"][0], capture()
    light = sequence(scene, scan)
    due = dg.simulate(scene.without("box", "other"), scan, ACCURACY, 0)
    np.testing.assert_array_equal(light.static, due.total)
    assert light.samplers == {"primary": "shared cuts"}


def test_frames_in_which_a_mover_stands_are_alike_to_the_bit() -> None:
    path = dg.Path((0.5, 1.0), [(1.5, 0.4, 1.2), (1.6, -0.5, 1.2)])
    scene, scan = room(moving_box(path=path)), capture()
    light = sequence(scene, scan, 6)
    for f in (1, 2):
        np.testing.assert_array_equal(light.moving[f], light.moving[0])
        assert light.change_errors[f] <= light.change_errors[5]
    assert light.change(5).any()
    due = dg.simulate(scene.at(0.0), scan, ACCURACY, 50)
    error = np.linalg.norm(light.total(0) - due.total) / np.linalg.norm(due.total)
    assert error <= 2.0 * np.hypot(light.relative_error[0], due.relative_error)


def test_a_path_that_no_light_gets_to_changes_nothing() -> None:
    away = dg.Path((0.0, 1.0), [(9.0, 0.4, 1.2), (9.5, -0.5, 1.2)])
    scan = capture()
    light = sequence(room(moving_box(path=away)), scan)
    due = dg.simulate(room(), scan, ACCURACY, 0)
    assert not light.moving.any()
    np.testing.assert_array_equal(light.total(2), due.total)
    assert light.relative_error == pytest.approx(due.relative_error)


def test_nothing_that_moves_is_one_scene() -> None:
    stands = dg.Path((0.0,), [(1.5, 0.4, 1.2)])
    scene, scan = room(moving_box(path=stands)), capture(pairing="exhaustive")
    light = sequence(scene, scan)
    due = dg.simulate(scene, scan, ACCURACY, 0)
    np.testing.assert_array_equal(light.static, due.total)
    assert not light.moving.any() and not light.change_errors.any() and light.samplers == due.samplers


def test_time_that_runs_backward_gives_the_frames_in_reverse() -> None:
    back = dg.Path(1.0 - HALF_TURN.times_s[::-1], HALF_TURN.places[::-1], HALF_TURN.headings_deg[::-1])
    scan = capture()
    # Only exposures that fill their frames are the same backward.
    forth, reverse = (sequence(room(moving_box(path=path)), scan, 4, exposure_s=None) for path in (HALF_TURN, back))
    for f in range(4):
        apart = np.linalg.norm(forth.moving[f] - reverse.moving[3 - f])
        claimed = np.hypot(forth.part_errors["box"][f], reverse.part_errors["box"][3 - f])
        assert apart <= (3 * claimed + 0.1) * np.linalg.norm(forth.moving[f])


@pytest.mark.parametrize("pairing", ["confocal", "exhaustive"])
def test_each_laser_point_has_its_own_time(pairing: dg.records.Pairing) -> None:
    """A rolling shutter is as many scenes with one laser point each."""
    scene, scan, seeds = CASES["box"][0], capture(2, pairing=pairing), 6
    times, _ = times_of(scan, dg.Clock(2, 2.0), None)
    lights = [light_of_sequence(scene, [scan] * 2, times, SHORT_S, ACCURACY, seed) for seed in range(seeds)]
    for laser in range(4):
        one = scan.excerpt(np.array([laser]))
        at = float(lights[0].times_s[1, laser])
        due = np.mean([dg.simulate(scene.at(at), one, FINE, 60 + s).total.sum() for s in range(3)])
        found = np.array([light.total(1)[laser].sum() for light in lights])
        error = found.std(ddof=1) / seeds**0.5
        assert abs(found.mean() - due) <= SIGMAS * error + SLACK * due, laser
    assert np.ptp(lights[0].times_s[1]) > 0.3


def test_light_is_negative_by_no_more_than_noise() -> None:
    for case in ("dark", "two", "exhaustive"):
        scene, pairing = CASES[case]
        light = sequence(scene, capture(pairing=pairing), 3)  # type: ignore[arg-type]
        assert light.moving.min() < 0
        for f in range(light.frames):
            total = light.total(f)
            assert np.linalg.norm(total[total < 0]) <= light.relative_error[f] * np.linalg.norm(total)


def test_a_mover_in_the_devices_view_has_its_frame_by_itself() -> None:
    path = dg.Path((0.0, 1.0), [(1.5, 0.4, 1.2), (1.0, -0.9, 1.4)])
    scene, scan = room(moving_box(path=path)), capture()
    light = sequence(scene, scan, 4)
    assert light.samplers["primary"].startswith("shared cuts; ")
    due = dg.simulate(scene.at(float(light.times_s[3].mean())), scan, ACCURACY, 0)
    np.testing.assert_allclose(light.total(3), due.total, rtol=0, atol=1e-12 * due.total.max())
    assert light.frame(3).relative_error == due.relative_error


def test_more_bounces_come_frame_by_frame() -> None:
    scene, scan = CASES["box"][0], capture()
    accuracy = replace(ACCURACY, target=0.1, max_bounces=4, direct=True)
    light = sequence(scene, scan, 3, accuracy=accuracy)
    assert light.samplers == {"direct": "frames: paths", "primary": "shared cuts", "secondary": "frames: blocks"}
    for f in range(3):
        due = dg.simulate(scene.at(float(light.times_s[f].mean())), scan, accuracy, 80)
        apart = np.linalg.norm(light.total(f) - due.total) / np.linalg.norm(due.total)
        assert apart <= 2.0 * np.hypot(light.relative_error[f], due.relative_error)
        assert light.total(f).sum() == pytest.approx(due.total.sum(), rel=0.05)
