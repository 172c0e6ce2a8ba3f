"""Samples of sequences: each frame is the scene of its time, and what changes from one to the next is known."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import datagen as dg
from datagen.config import DatasetConfig, config_from_mapping
from datagen.detector.carry_over import share_carried_over
from datagen.errors import InputError
from datagen.evidence.change import changes_of
from datagen.labels import make_labels
from datagen.pipeline import Setup, sample_of_setup, sequence_from, simulated_frames
from datagen.records.label_fields import LABEL_FIELDS
from tests.sequences.rooms_that_move import box, capture, room

FRAMES = 4
CLOCK = dg.Clock(frames=FRAMES, rate_hz=4)
WALL = dg.Rectangle.of((0, 0, 1.5), (0, 1, 0), (0, 0, 1.5))
KNOWN = {"relay_wall": WALL, "hidden_view": WALL, "hidden_bounds": [(0, -2, 0), (3, 2, 3)]}
FIELDS = ("histogram", "transient", "transient_stderr", "background_histogram", "background_transient", "depth",
          "part_id", "normal", "shaded", "occupancy", "sdf", "evidence", "objects", "presence",
          "zone_depth")  # fmt: skip
WALK = dg.Path((0.0, 1.0), [(1.5, 0.5, 1.2), (1.2, -0.5, 1.2)], (0, 40))
OTHER = dg.Path((0.0, 0.5, 1.0), [(2.2, -0.9, 0.6), (2.4, -0.9, 0.6), (2.4, -0.4, 0.6)])


def scene_of(*paths: dg.Path | None, albedo: float = 0.6) -> dg.Scene:
    """A room with a box on each path; one without a path stands at the place of its mesh."""
    still = box().apply_translation((2.0, 1.2, 0.8))
    parts = [
        dg.Part(f"box_{k}", still if path is None else box(), dg.Lambertian(albedo), path=path)
        for k, path in enumerate(paths)
    ]
    return room(*parts, **KNOWN)


def config_of(scenes: int = 1, fields: tuple[str, ...] = FIELDS, **sections: Any) -> DatasetConfig:
    values: dict[str, Any] = {
        "scenes": scenes, "seed": 5, "transport": {"target": 0.05},
        "scene": {"layout": {"kind": "given", "digest": "0" * 64, "classes": ["box_0", "box_1"], "most_objects": 3},
                  "contents": []},
        "capture": {"scan": {"kind": "points", "points_m": capture().laser.targets.tolist()},
                    "time": {"bins": 256, "bin_width_ps": 100}},
        "sequence": {"frames": FRAMES, "rate_hz": 4}, "labels": {"rows": 12, "columns": 10, "voxels": [4, 5, 6]},
        "detector": {"mode": "ideal", "cycles": 200_000, "photons_per_pulse": 1e9, "jitter_fwhm_ps": 0,
                     "pulse_fwhm_ps": 0},
        "store": {"fields": list(fields)},
    }  # fmt: skip
    return config_from_mapping({**values, **sections})


def setup_of(scene: dg.Scene, config: DatasetConfig | None = None) -> Setup:
    return Setup.of(config or config_of(), 0, scene, capture(), clock=CLOCK)


@pytest.fixture(scope="module")
def sample() -> dg.Sample:
    """Of a box that walks and one that stands."""
    return sample_of_setup(setup_of(scene_of(WALK, None)))


def test_a_frame_has_the_labels_of_its_middle(sample: dg.Sample) -> None:
    config, scene, times = config_of(), scene_of(WALK, None), setup_of(scene_of(WALK, None)).times
    assert times is not None
    np.testing.assert_allclose(times.middles, times.points.mean(axis=1))
    names = ("depth", "part_id", "normal", "shaded", "occupancy", "sdf", "objects")
    for frame, middle in enumerate(times.middles):
        due = make_labels(config.labels, scene.at(middle), names, ("box_0", "box_1"), 3)
        for of in LABEL_FIELDS:
            if of.name in due:
                found = sample.arrays[of.name]
                np.testing.assert_array_equal(found if of.over_frames == "same" else found[frame], due[of.name])
    assert not np.array_equal(sample.arrays["depth"][0], sample.arrays["depth"][3])
    np.testing.assert_array_equal(sample.arrays["laser_time"], times.points)


def test_boxes_move_as_their_velocity_says(sample: dg.Sample) -> None:
    arrays = sample.arrays
    for name in ("object_velocity", "object_turning"):
        assert arrays[name].shape == (FRAMES, 3, 3) and not arrays[name][:, 1:].any()
    # The middle of this box is the origin of its mesh, on a straight leg.
    moved = np.diff(arrays["object_box_center"][:, 0], axis=0) * CLOCK.rate_hz
    np.testing.assert_allclose(arrays["object_velocity"][1:, 0], moved, atol=1e-5)
    assert 0.9 < np.linalg.norm(moved[0]) < 1.2
    # A box that is turned by ω for a time: R' = exp(ω × t) R, of which the trace knows the angle.
    rotation, turning = arrays["object_box_rotation"][:, 0].astype(float), arrays["object_turning"][:, 0]
    for frame in range(FRAMES - 1):
        turn = rotation[frame + 1] @ rotation[frame].T
        angle = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2
        np.testing.assert_allclose(angle * CLOCK.rate_hz, turning[frame], rtol=2e-2, atol=1e-6)
    assert np.linalg.norm(turning[0]) == pytest.approx(np.radians(40), rel=1e-6)


def test_light_and_counts_are_those_of_the_frames(sample: dg.Sample) -> None:
    config, scene = config_of(), scene_of(WALK, None)
    setup = setup_of(scene)
    light, arrays = simulated_frames(setup).frames, sample.arrays
    np.testing.assert_array_equal(arrays["transient"], light.static + light.moving)
    np.testing.assert_array_equal(arrays["transient_stderr"], light.stderr)
    exposure = dg.Exposure(cycles=200_000, photons_per_pulse=1e9)
    for frame in range(FRAMES):
        due = dg.expected_histogram(
            np.maximum(light.total(frame), 0.0), light.time, dg.Spad(pde=0.3, mode="ideal"), exposure
        ).sum()
        counts = arrays["histogram"][frame].sum()
        assert abs(counts - due - 100 * 0.02 * 9) < 5 * np.sqrt(due) and due > 1000
    # Counts of a frame have noise of their own.
    background = arrays["background_histogram"]
    assert not np.array_equal(background[0], background[1])
    assert np.array_equal(arrays["background_transient"][0], arrays["background_transient"][3])
    empty = dg.simulate(scene.without("box_0", "box_1"), capture(), dg.Accuracy(target=0.05), setup.seed(3))
    np.testing.assert_allclose(arrays["background_transient"][0].sum(), empty.total.sum(), rtol=0.02)
    assert config.store.fields == FIELDS and set(sample.arrays) >= {*FIELDS} - {"objects", "presence"}


def test_evidence_is_the_median_over_frames(sample: dg.Sample) -> None:
    own, parameters = sample.arrays["object_significance"][:, :2], sample.parameters
    assert parameters["evidence.weakest"] == pytest.approx(np.median(own.min(axis=1)), rel=1e-6)
    assert parameters["evidence.box_0.significance"] == pytest.approx(np.median(own[:, 0]), rel=1e-6)
    change, floor = sample.arrays["object_change"], sample.arrays["object_change_floor"]
    assert not change[0].any() and not change[:, 1:].any() and not floor[0].any() and not floor[:, 1:].any()
    assert (change[1:, 0] > 0).all() and (floor[1:, 0] > 0).all()
    assert parameters["evidence.box_0.change"] == pytest.approx(np.median(change[1:, 0]), rel=1e-6)
    assert "evidence.box_1.change" not in parameters
    # One box walks away from the wall's middle, and both presences are known in all frames.
    assert (sample.arrays["object_presence"][:, :2] > 0).all()


@pytest.mark.parametrize("mode", ["ideal", "free_running"])
def test_a_change_is_what_a_matched_filter_finds(mode: Any) -> None:
    scene, exposure = scene_of(WALK), dg.Exposure(cycles=10**6, photons_per_pulse=1e9)
    spad = dg.Spad(mode=mode, dead_time_s=50e-9)
    light = dg.simulate_sequence(scene, capture(), CLOCK, dg.Accuracy(target=0.05), 2)
    found = changes_of(scene, light, spad, exposure)["box_0"]
    # As detectors get it, in which no light is negative.
    totals = [np.maximum(light.total(frame), 0.0) for frame in range(FRAMES)]
    means = [dg.expected_histogram(total, light.time, spad, exposure) for total in totals]
    assert found[0].significance == found[0].floor == 0.0
    for frame in range(1, FRAMES):
        d, both = means[frame] - means[frame - 1], means[frame] + means[frame - 1]
        due = np.sqrt(np.sum(np.divide(d * d, both, out=np.zeros_like(d), where=both > 0)))
        assert found[frame].significance == pytest.approx(due, rel=1e-3)
        # Σ w n / √Σ w² both with w = d / both: the mean of the filter over its spread, from drawn counts.
        if mode == "ideal" and frame == 1:
            w = np.divide(d, both, out=np.zeros_like(d), where=both > 0)
            drawn = [
                sum(sign * (w * dg.detect(totals[of], light.time, spad, exposure, seed=10 * k + of)).sum()
                    for of, sign in ((1, 1), (0, -1)))
                for k in range(300)
            ]  # fmt: skip
            # Five standard errors of a mean over a spread.
            assert np.mean(drawn) / np.std(drawn) == pytest.approx(due, abs=5 * np.sqrt((1 + due**2 / 2) / 300))


def test_of_several_objects_each_has_the_change_of_its_own_light() -> None:
    spad, exposure = dg.Spad(mode="ideal"), dg.Exposure(cycles=10**6, photons_per_pulse=1e9)
    both = scene_of(WALK, OTHER)
    light = dg.simulate_sequence(both, capture(), CLOCK, dg.Accuracy(target=0.05), 2)
    found = changes_of(both, light, spad, exposure)
    for name, every in found.items():
        own = [dg.expected_histogram(of, light.time, spad, exposure) for of in light.parts[name]]
        totals = [np.maximum(light.total(f), 0.0) for f in range(FRAMES)]
        all_ = [dg.expected_histogram(total, light.time, spad, exposure) for total in totals]
        for frame in range(1, FRAMES):
            d, b = own[frame] - own[frame - 1], all_[frame] + all_[frame - 1]
            due = np.sqrt(np.sum(np.divide(d * d, b, out=np.zeros_like(d), where=b > 0)))
            assert every[frame].significance == pytest.approx(due, rel=1e-6) and due > 0
    unsplit = changes_of(both, replace(light, parts={}, part_errors={}), spad, exposure)
    assert all(np.isnan(of.significance) for every in unsplit.values() for of in every[1:])


def test_light_below_zero_is_clipped_in_the_rate_alone() -> None:
    setup = setup_of(scene_of(WALK), config_of(fields=("histogram", "transient")))
    light = simulated_frames(setup)
    frames = light.frames
    below = frames.moving.copy()
    where = (2, 4, 0, int(frames.total(2)[4, 0].argmax()))
    below[where] = -(frames.static[where[1:]] + 1e-9)
    sample = sequence_from(setup, replace(light, frames=replace(frames, moving=below)))
    assert sample.arrays["transient"][where] == pytest.approx(-1e-9)
    assert sample.arrays["histogram"][where] < 5
    few = float(sequence_from(setup, light).parameters["transient.clipped"])
    assert 0 <= few < 0.01 and few < float(sample.parameters["transient.clipped"]) <= 1


def test_exposures_that_do_not_fit_or_carry_counts_over_are_refused() -> None:
    for detector, words in (
        ({"cycles": 300_000}, r"sequence.rate_hz = 4: a frame lasts 250 ms.*277777 cycles .* of detector.cycles fit"),
        ({"cycles": 40, "mode": "free_running"}, r"detector.cycles = 40: .*1.25 × the cycles"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=words):
            config = config_of(sequence={"frames": FRAMES, "rate_hz": 4}, detector={"cycles": 1})
            kept = config.detector.model_copy(update={"mode": "ideal", **detector})
            setup_of(scene_of(WALK), config.model_copy(update={"detector": kept}))
    exposure = dg.Exposure(cycles=3900)
    spad = dg.Spad(dead_time_s=50e-9, afterpulse_probability=0.01, afterpulse_times_s=(50e-9,))
    assert share_carried_over(spad, exposure) == pytest.approx(2.5e-4, rel=0.05)
    assert share_carried_over(replace(spad, mode="synchronous"), exposure) == 0.0


def test_a_flood_and_pairs_have_frames_too() -> None:
    pairs = capture(side=2, pairing="exhaustive")
    for scan, points in ((pairs, 4), (replace(pairs, illumination="flood"), 1)):
        view = {"rows": 2, "columns": 2}
        config = config_of(
            fields=("histogram", "transient"),
            capture={"pairing": "exhaustive", "illumination": scan.illumination, "field_of_view": view,
                     "scan": {"kind": "points", "points_m": scan.laser.targets.tolist()},
                     "time": {"bins": 256, "bin_width_ps": 100}},
        )  # fmt: skip
        sample = sample_of_setup(Setup.of(config, 0, scene_of(WALK), scan, clock=CLOCK))
        assert sample.arrays["histogram"].shape == sample.arrays["transient"].shape == (FRAMES, points, 4, 256)
        assert sample.arrays["laser_time"].shape == (FRAMES, points)


def test_how_light_is_split_into_what_stands_and_what_moves_does_not_matter(sample: dg.Sample) -> None:
    """But for rounding: light that stands apart from what moves, which has a sign, gives the same sample."""
    setup = setup_of(scene_of(WALK, None))
    light = simulated_frames(setup)
    whole = light.frames.static + light.frames.moving
    static = whole.mean(axis=0)
    shared = replace(light.frames, static=static, moving=whole - static, samplers={"primary": "shared cuts"})
    assert (shared.moving < 0).any()
    other = sequence_from(setup, replace(light, frames=shared))
    for name, values in sample.arrays.items():
        if values.dtype.kind == "f":
            np.testing.assert_allclose(other.arrays[name], values, rtol=1e-5, atol=1e-5 * np.nanmax(abs(values)))
        else:
            assert np.mean(other.arrays[name] != values) < 1e-3, name
    assert other.parameters["transient.energy"] == pytest.approx(sample.parameters["transient.energy"])
