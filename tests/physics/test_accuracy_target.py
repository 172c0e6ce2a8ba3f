"""Light to a target: the error that is claimed is the error there is, the light is right, and it always ends."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from rooms import bins_of_path, furnished_box, one_point_capture, rectangle, square_pixels
from scipy import stats

from datagen import GGX, Accuracy, Capture, Lambertian, Laser, Part, Scene, Sensor, simulate
from datagen.bench.plain_check import PlainPaths
from datagen.errors import InputError
from datagen.records import Material, Transient
from datagen.transport.blocks import Blocks, BlocksOf
from datagen.transport.effort import REPLICATES, estimate_of
from datagen.transport.problem import Problem

AXIS = bins_of_path(40, 0.5, 0.0)
DEVICE = np.array([2.0, 0.0, 1.2])
LEVEL = 1e-3
"""Probability that a test fails by chance."""
RUNS = 12


@cache
def runs() -> list[Transient]:
    """Runs with different seeds of a furnished room with five bounces to 5 %."""
    accuracy = Accuracy(max_bounces=5, target=0.05)
    return [simulate(furnished_box(0.7), one_point_capture(time=AXIS), accuracy, seed=s) for s in range(RUNS)]


def test_the_claimed_error_is_the_error_there_is() -> None:
    """Root mean square of the true errors of all runs, by plain paths with their noise taken out, over that of the
    claims."""
    truth = PlainPaths.of(furnished_box(0.7), one_point_capture(time=AXIS), Accuracy(max_bounces=5), 1 << 13, 99)
    names = ("primary", "secondary", "higher")
    found = [truth.check(run.total, *names) for run in runs()]
    true = np.sqrt(max(np.mean([one.square for one in found]), 0.0))
    claimed = np.sqrt(np.mean([run.relative_error**2 for run in runs()]))
    assert 0.7 < true / claimed < 1.4
    assert claimed < 1.25 * 0.05 and all(run.met_target for run in runs())
    for name in ("secondary", "higher"):
        energies = truth.runs[name].sum(axis=(1, 2))
        ours = np.array([run.components[name].sum() for run in runs()])
        off = ours.mean() - energies.mean()
        known = np.hypot(stats.sem(ours), stats.sem(energies))
        assert abs(off) < stats.t.isf(LEVEL / 4, len(energies) - 1) * known, name
        assert known < 0.05 * energies.mean(), "known well enough to tell"


def test_errors_of_components_scatter_as_their_standard_errors_say() -> None:
    """Means of squared standardised differences between runs, over bins that hold light."""
    total = np.array([run.components["secondary"] + run.components["higher"] for run in runs()])
    claimed = np.sqrt(np.mean([run.stderr**2 for run in runs()], axis=0))
    filled = total.mean(axis=0) > 0.02 * total.mean(axis=0).max()
    ratio = total.std(axis=0, ddof=1)[filled] / claimed[filled]
    assert 0.3 < np.sqrt((ratio**2).mean()) < 1.4


@pytest.mark.parametrize("shape", ["broad", "spike"])
def test_what_boxes_blur_is_part_of_the_error(shape: str) -> None:
    """Gaussian replicates about a known curve: squared errors are not claimed too small in the mean, though the
    widths of boxes are chosen by what they are judged by; and too large by less than 2.5 times, as half of the
    replicates choose widths worse than all of them."""
    rng, bins = np.random.default_rng(3), 240
    truth = np.exp(-0.5 * ((np.arange(bins) - 120) / (25 if shape == "broad" else 1.5)) ** 2)
    true, claimed, plain = [], [], []
    for _ in range(200):
        each = (truth + 0.3 * rng.normal(size=(REPLICATES, 1, bins))).astype(np.float32)
        mean, error2, variance, _ = estimate_of(each)
        true.append(float(((mean[0] - truth) ** 2).sum()))
        claimed.append(error2)
        plain.append(float(variance.sum()))
    assert 0.4 < np.mean(true) / np.mean(claimed) < 1.05
    assert np.mean(true) < (0.1 if shape == "broad" else 0.2) * np.mean(plain)


def test_same_arguments_and_seed_give_the_same_bytes() -> None:
    again = simulate(furnished_box(0.7), one_point_capture(time=AXIS), Accuracy(max_bounces=5, target=0.05), seed=1)
    for name, light in runs()[1].components.items():
        assert light.tobytes() == again.components[name].tobytes()
    assert again.stderr.tobytes() == runs()[1].stderr.tobytes()
    assert (again.total != runs()[2].total).any()


def test_it_says_where_its_light_comes_from_and_a_smaller_target_takes_more() -> None:
    run = runs()[0]
    assert dict(run.samplers) == {"primary": "cuts", "secondary": "blocks", "higher": "blocks"}
    tight = simulate(furnished_box(0.7), one_point_capture(time=AXIS), Accuracy(max_bounces=5, target=0.005), seed=0)
    assert all(tight.rays[name] > 2 * run.rays[name] > 0 for name in run.rays)
    assert tight.relative_error < 0.3 * run.relative_error
    assert run.relative_error == run.claimed_error


def test_nothing_visible_ends_with_zero() -> None:
    """A bare wall sends no light to itself, and a laser that misses everything lights nothing: the transient is
    zero."""
    wall = Scene.from_parts([Part("wall", rectangle((0, 0, 1), (0, 1, 0), (0, 0, 1)), Lambertian(0.8))])
    sensor = Sensor(DEVICE, square_pixels([[0, 0.3, 1.0]], 0.1))
    dark = simulate(wall, Capture(Laser(DEVICE, [[0, -0.3, 1]]), sensor, AXIS), Accuracy(max_bounces=4, target=0.05))
    with pytest.warns(UserWarning, match="meet nothing"):
        missed = simulate(wall, Capture(Laser(DEVICE, [[9, 9, 1]]), sensor, AXIS), Accuracy(target=0.05))
    for transient in (dark, missed):
        assert not transient.total.any() and not transient.stderr.any()
        assert transient.relative_error == 0 and transient.met_target


def touching(material: Material) -> tuple[Scene, Capture]:
    """A plate touches the wall inside the field of view, 1 mm from the laser point, so that the brightest paths are
    the shortest."""
    plate = rectangle((0.3, 0.5, 1), (0.3, 0, 0), (0, 0, 0.5))
    wall = rectangle((0, 0, 1), (0, 1, 0), (0, 0, 1))
    scene = Scene.from_parts([Part("wall", wall, material), Part("plate", plate, material)])
    sensor = Sensor(DEVICE, square_pixels([[0, 0.45, 1.0]], 0.1))
    return scene, Capture(Laser(DEVICE, [[0, 0.499, 1]]), sensor, AXIS)


@pytest.mark.parametrize("material", [Lambertian(0.8), GGX(0.6, roughness=0.8, f0=0.2)], ids=["matte", "glossy"])
def test_a_few_blocks_find_the_light_between_touching_surfaces(material: Material) -> None:
    """Energies of runs of 256 blocks, a fifth of a second each, agree with plain paths, and scatter by some per cent:
    no rare path brings much. Without rays that land they scatter by 120 % and 36 %."""
    scene, capture = touching(material)
    accuracy = Accuracy(max_bounces=5)
    truth = PlainPaths.of(scene, capture, accuracy, 1 << 15, 99)
    for name, last in (("secondary", 4), ("higher", 5)):
        ours = np.empty(RUNS)
        for seed in range(RUNS):
            blocks = BlocksOf(Blocks(Problem.of(scene, capture, accuracy, seed, split_parts=False)), last)
            light = np.zeros((1, AXIS.bins + 2), np.float32)
            for number in range(256):
                blocks.add(0, 0, number, light)
            ours[seed] = light[:, 1:-1].sum() * blocks.unit / 256
        wanted = truth.runs[name].sum(axis=(1, 2))
        allowed = stats.t.isf(LEVEL / 8, len(wanted) - 1) * np.hypot(stats.sem(ours), stats.sem(wanted))
        assert ours.mean() == pytest.approx(wanted.mean(), abs=allowed), name
        assert ours.std(ddof=1) < 0.1 * wanted.mean(), name


def test_touching_surfaces_come_to_an_end() -> None:
    """With paths of any length between surfaces the primary is right, and the target is met."""
    scene, capture = touching(Lambertian(0.8))
    found = [simulate(scene, capture, Accuracy(max_bounces=4, target=0.05), seed=s) for s in range(4)]
    truth = PlainPaths.of(scene, capture, Accuracy(), 1 << 15, 99)
    assert all(run.met_target for run in found)
    # Plain paths themselves know this light to some per cent only.
    primary = np.mean([run.components["primary"].sum() for run in found])
    wanted = truth.runs["primary"].sum(axis=(1, 2))
    assert abs(primary - wanted.mean()) < 4 * stats.sem(wanted) + 0.1 * wanted.mean()


def test_a_pixel_at_the_foot_of_a_wall_gets_the_light_from_beside_it() -> None:
    """Half of what such a pixel sees is the nearest few centimetres of the other wall."""
    eye = one_point_capture((0, 0.3, 1.2))
    pixel = square_pixels([[0, -1.475, 1.2]], 0.025)
    capture = Capture(eye.laser, Sensor(eye.sensor.position, pixel), bins_of_path(64, 0.5, 0.0))
    truth = PlainPaths.of(furnished_box(), capture, Accuracy(max_bounces=4), 1 << 15, 99).runs["secondary"]
    wanted = truth.sum(axis=(1, 2))
    found = np.array([
        simulate(furnished_box(), capture, Accuracy(target=0.05, max_bounces=4), seed=s).components["secondary"].sum()
        for s in range(8)
    ])  # fmt: skip
    allowed = stats.t.isf(LEVEL / 2, 7) * np.hypot(stats.sem(found), stats.sem(wanted))
    assert found.mean() == pytest.approx(wanted.mean(), abs=allowed)
    assert allowed < 0.15 * wanted.mean()


def test_an_error_of_all_bins_alike_counts() -> None:
    """Replicates that differ by a common factor, as where one rare path brings much of the light: boxes cannot lower
    that error, and it is claimed in full."""
    rng = np.random.default_rng(4)
    factor = 1 + 0.2 * rng.normal(size=(REPLICATES, 1, 1))
    each = (factor * np.ones((1, 1, 200))).astype(np.float32)
    _, error2, variance, _ = estimate_of(each)
    assert error2 == pytest.approx(variance.sum(), rel=0.05, abs=0)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"target": 0.02, "samples": 2048}, r"samples = 2048: given together with Accuracy.target = 0.02"),
        ({"target": 0}, r"target = 0: .*0\.0001"),
        ({"samples": 0}, r"samples = 0: .*1"),
        ({"samples": 64, "part_target": 0.1}, r"part_target = 0.1: needs a target"),
        ({"max_bounces": 2}, r"max_bounces = 2: .*direct=True"),
        ({"secondary": "strongest"}, r"secondary = 'strongest': .*datagen\.paper\.secondary"),
    ],
)
def test_what_means_nothing_is_refused_in_one_line(given: dict, words: str) -> None:
    with pytest.raises(InputError, match=rf"Accuracy\.{words}") as error:
        Accuracy(**given)
    assert "\n" not in str(error.value)
