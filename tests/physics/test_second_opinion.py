"""The second opinion: unbiased samples detect light that elements lost or invented, and accept light that is
right."""

from dataclasses import replace

import numpy as np
import pytest

import datagen as dg
from datagen.records import Accuracy
from datagen.transport.error_control import primary as adaptive
from datagen.transport.error_control.second_opinion import Claim, second_opinion
from datagen.transport.problem import Problem
from datagen.transport.quadrature.gathering import Gathering
from datagen.transport.quadrature.three_bounces import primary_by_cells
from tests.rooms import bins_of_path, furnished_box, square_pixels

SEEDS = range(6)


def scan(points_a_side):
    """A confocal scan of the furnished box's relay wall."""
    y, z = np.meshgrid(np.linspace(-0.7, 0.7, points_a_side), np.linspace(0.6, 1.9, points_a_side))
    points = np.column_stack([np.zeros(y.size), y.ravel(), z.ravel()])
    device = (1.5, 0.3, 1.4)
    sensor = dg.Sensor(device, square_pixels(points, 0.004), aperture_radius_m=0.02)
    return dg.Capture(dg.Laser(device, points), sensor, bins_of_path(256, 0.06, 0.0), pairing="confocal")


@pytest.fixture(scope="module")
def found():
    """A problem, and the claims of its primary."""
    task = Problem.of(furnished_box(), scan(8), Accuracy(target=0.02), 0, split_parts=True)
    primary = primary_by_cells(Gathering.of(task), 0.02, 0.05)
    return task, adaptive._claims(task, primary)


def darker(claims, names, share):
    return {
        name: replace(claim, light=claim.light * share) if name in names else claim for name, claim in claims.items()
    }


def test_right_light_is_left_alone(found):
    """None of six opinions disagrees, each at `LEVEL` = 10⁻⁴ over all parts and windows of a scene."""
    task, claims = found
    assert all(second_opinion(task, claims, turn=seed).agrees for seed in SEEDS)


@pytest.mark.parametrize("share", [0.85, 1.15])
def test_a_seventh_of_the_whole_is_found_missing_or_too_much(found, share):
    task, claims = found
    wrong = darker(claims, set(claims), share)
    opinions = [second_opinion(task, wrong, turn=seed) for seed in SEEDS]
    assert not any(opinion.agrees for opinion in opinions)
    assert all((opinion.off < 0) == (share < 1) for opinion in opinions)


def test_half_of_an_object_is_found_missing(found):
    """The object has a few hundredths of all light, so that the loss of half of it would not show in the whole."""
    task, claims = found
    objects = [name for name, role in zip(task.scene.part_names, task.scene.roles, strict=True) if role == "object"]
    assert objects
    for name in set(objects) & set(claims):
        opinions = [second_opinion(task, darker(claims, {name}, 0.5), turn=seed) for seed in SEEDS]
        assert np.mean([not opinion.agrees and opinion.worst == name for opinion in opinions]) > 0.75


def test_light_that_comes_in_the_wrong_window_is_found(found):
    task, claims = found
    late = {name: replace(claim, light=np.roll(claim.light, 40, axis=2)) for name, claim in claims.items()}
    assert not any(second_opinion(task, late, turn=seed).agrees for seed in SEEDS)


def test_a_scene_whose_light_is_disputed_is_sampled_and_says_so(monkeypatch):
    """If the primary loses a third of all light at every fineness, paths replace it."""
    scene, capture = furnished_box(), scan(3)

    def lossy(gathering, target, part_target, faint=0.0):
        right = primary_by_cells(gathering, target, part_target, faint)
        return replace(right, rows=[0.67 * row for row in right.rows])

    right = dg.simulate(scene, capture, Accuracy(target=0.05), seed=3)
    assert right.samplers["primary"] == "quadrature" and right.second_opinion.startswith("agrees: of ")
    monkeypatch.setattr(adaptive, "primary_by_cells", lossy)
    disputed = dg.simulate(scene, capture, Accuracy(target=0.05), seed=3)
    assert disputed.samplers["primary"] == "paths"
    assert disputed.second_opinion.count("disagrees: of ") == len(adaptive.TRIES)
    assert disputed.total.sum() == pytest.approx(right.total.sum(), rel=0.05)


def test_no_light_is_no_dispute(found):
    task, claims = found
    nothing = {"primary": Claim(np.zeros_like(claims["primary"].light), 0.0, 3, part=0)}
    assert second_opinion(task, nothing).samples > 0
