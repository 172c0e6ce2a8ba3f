"""Laws of what moves while a laser point is measured: its light is the mean over the exposure."""

from __future__ import annotations

import numpy as np
import pytest

import datagen as dg
from datagen.records.arrays import l2_norm
from datagen.transport.dwell import MOST, SHARP, instants, path_change
from datagen.transport.sequences import light_of_frames, times_of
from tests.sequences.rooms_that_move import box, capture, room

TOWARD = dg.Path((0.0, 1.0), [(1.9, 0.4, 1.2), (1.1, 0.1, 1.2)], (0, 60))
SCENE = room(dg.Part("box", box(), dg.Lambertian(0.6), path=TOWARD))
SPEED_OF_LIGHT = 299_792_458.0


def path_change_of(path: dg.Path, exposure_s: float, width_s: float = 1e-10, arm_m: float = 0.0) -> float:
    """Of a box of 0.5 × 0.5 m, whose middle is `arm_m` beside its origin, in one frame of one point."""
    mesh = box().apply_translation((arm_m, 0, 0))
    scene = room(dg.Part("box", mesh, dg.Lambertian(0.5), path=path))
    return path_change(scene, capture(width_s=width_s), np.array([[0.5]]), exposure_s)


def test_a_path_changes_by_twice_the_way() -> None:
    straight = dg.Path((0.0, 2.0), [(1.5, 0, 1), (1.5, 3, 1)])
    assert path_change_of(straight, 0.01) == pytest.approx(2 * 1.5 * 0.01 / (SPEED_OF_LIGHT * 1e-10))
    assert path_change_of(straight, 0.01, 1e-11) == pytest.approx(10 * path_change_of(straight, 0.01))
    # What turns moves as fast as its farthest point.
    turning = dg.Path((0.0, 1.0), [(1.5, 0, 1), (1.5, 0, 1)], (0, 90))
    radius = np.hypot(1.0 + 0.25, 0.25)
    due = 2 * np.pi / 2 * radius * 0.01 / (SPEED_OF_LIGHT * 1e-10)
    assert path_change_of(turning, 0.01, arm_m=1.0) == pytest.approx(due)


def test_a_jump_has_no_speed_and_what_is_over_does_not_count() -> None:
    jump = dg.Path((0.5, 0.5), [(1.5, 0, 1), (1.5, 1, 1)])
    assert path_change_of(jump, 0.1) == 0.0
    past = dg.Path((0.0, 0.1), [(1.5, 0, 1), (1.5, 1, 1)])
    assert path_change_of(past, 0.1) == 0.0 and path_change_of(past, 0.9) > 0


def test_instants_are_spread_evenly_over_an_exposure() -> None:
    times = np.array([[1.0, 2.0], [3.0, 4.0]])
    np.testing.assert_array_equal(instants(times, 0.5, SHARP, MOST), times[None])
    assert len(instants(times, 0.5, SHARP + 1e-6, MOST)) == 2 and len(instants(times, 0.5, 1e6, MOST)) == MOST
    many = instants(times, 0.5, 6.5, MOST)
    share = (many - times) / 0.5 + 0.5
    np.testing.assert_allclose(share, np.broadcast_to(((np.arange(7) + 0.5) / 7)[:, None, None], (7, 2, 2)))


@pytest.mark.parametrize("pairing", ["confocal", "exhaustive"])
def test_a_long_exposure_is_the_mean_of_short_ones(pairing: dg.records.Pairing) -> None:
    """Of light that frames share, and of its parts; the middle alone is far off."""
    scan, accuracy, long, short = capture(2, pairing=pairing), dg.Accuracy(target=0.02), 0.2, 96
    blurred = [
        dg.simulate_sequence(SCENE, scan, dg.Clock(2, 1 / long, "together"), accuracy, seed) for seed in range(4)
    ]
    assert blurred[0].samplers == {"primary": "shared cuts"}
    clock = dg.Clock(2 * short, short / long, "together")
    fine = [dg.simulate_sequence(SCENE, scan, clock, accuracy, seed, exposure_s=1e-9) for seed in (9, 10)]
    middle = dg.simulate_sequence(SCENE, scan, dg.Clock(2, 1 / long, "together"), accuracy, 9, exposure_s=1e-9)
    for f in range(2):
        frames = slice(f * short, (f + 1) * short)
        due = np.mean([light.moving[frames] for light in fine], axis=(0, 1))
        own = np.mean([light.parts["box"][frames] for light in fine], axis=(0, 1))
        for light in blurred:
            asked = 3 * light.part_errors["box"][f]
            assert l2_norm(light.parts["box"][f] - own) <= (asked + 0.01) * l2_norm(own)
            assert l2_norm(light.moving[f] - due) <= (asked + 0.03) * l2_norm(due)
        found = np.mean([light.moving[f].sum() for light in blurred])
        assert found == pytest.approx(due.sum(), rel=0.02)
        assert l2_norm(middle.parts["box"][f] - own) > 0.15 * l2_norm(own)
    change = due - np.mean([light.moving[:short] for light in fine], axis=(0, 1))
    true = np.mean([l2_norm(light.change(1) - change) for light in blurred])
    assert true <= 2.0 * np.mean([light.change_errors[1] for light in blurred])


@pytest.mark.parametrize("accuracy", [dg.Accuracy(target=0.03), dg.Accuracy(samples=4096, direct=True)])
def test_so_it_is_of_frames_by_themselves(accuracy: dg.Accuracy) -> None:
    scan, long = capture(2), 0.04
    times, _ = times_of(scan, dg.Clock(1, 1 / long, "together"), long)
    light = light_of_frames(SCENE, [scan], times, long, accuracy, 3)
    share = (np.arange(16) + 0.5) / 16
    fine = [dg.simulate(SCENE.at(float(at)), scan, dg.Accuracy(target=0.01), 50 + k).parts["box"]
            for k, at in enumerate(long * share)]  # fmt: skip
    own = np.mean(fine, axis=0)
    assert light.parts["box"][0].sum() == pytest.approx(own.sum(), rel=0.05)
    if accuracy.target is not None:
        assert light.relative_error[0] <= 1.3 * accuracy.target and light.met_target is not None
        assert l2_norm(light.parts["box"][0] - own) <= (3 * light.part_errors["box"][0] + 0.03) * l2_norm(own)


def test_more_bounces_are_those_of_the_exposure_too() -> None:
    scan, long = capture(2), 0.3
    accuracy = dg.Accuracy(target=0.05, max_bounces=4)
    light = dg.simulate_sequence(SCENE, scan, dg.Clock(1, 1 / long, "together"), accuracy, 1)
    assert light.samplers["secondary"] == "frames: blocks"
    share = (np.arange(6) + 0.5) / 6
    due = np.mean([dg.simulate(SCENE.at(float(at)), scan, accuracy, 20 + k).total.sum()
                   for k, at in enumerate(long * share)])  # fmt: skip
    assert light.total(0).sum() == pytest.approx(due, rel=0.03)
    assert light.relative_error[0] <= 1.3 * accuracy.target
