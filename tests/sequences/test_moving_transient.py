"""The light of what moves, apart from that of the scene without it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import datagen as dg
from datagen.building.plan import plan_build
from datagen.config import config_from_mapping
from datagen.errors import InputError
from datagen.formats import export
from datagen.records import SequenceLight
from datagen.store import read_manifest, verify
from datagen.transport.sequences import light_of_sequence, times_of
from tests.sequences.rooms_that_move import box, capture, plate, room

SHORT_S = 1e-6
"""An exposure in which nothing moves."""
FRAMES, CLOCK = 3, dg.Clock(frames=3, rate_hz=3)
PATH = dg.Path((0.0, 1.0), [(2.4, 1.3, 0.6), (2.5, 0.6, 0.6)], (0, 40))
SCENE = room(
    dg.Part("box", box((0.4, 0.4, 0.6)), dg.Lambertian(0.6), path=PATH),
    dg.Part("still", box().apply_translation((1.2, 1.5, 0.6)), dg.Lambertian(0.6)),
)
SCAN = capture()
FLOOD = replace(SCAN, pairing="exhaustive", illumination="flood")
TARGET = dg.Accuracy(target=0.05)
WAYS: dict[str, tuple[dg.Capture, dg.Accuracy]] = {
    "shared": (SCAN, TARGET),
    "four bounces": (SCAN, dg.Accuracy(target=0.05, max_bounces=4)),
    "all bounces, direct": (SCAN, dg.Accuracy(target=0.05, max_bounces=None, direct=True)),
    "samples": (SCAN, dg.Accuracy(samples=64, max_bounces=3)),
    "flood": (FLOOD, dg.Accuracy(samples=64, max_bounces=3)),
}


def light_of(scan: dg.Capture, accuracy: dg.Accuracy, seed: int = 0, scene: dg.Scene = SCENE) -> SequenceLight:
    """The light of frames, in which what moves is told apart."""
    times, _ = times_of(scan, CLOCK, None)
    return light_of_sequence(scene, [scan] * FRAMES, times, SHORT_S, accuracy, seed, apart=True)


@pytest.mark.parametrize("way", WAYS)
def test_all_light_less_that_of_what_moves_is_the_scene_without_it(way: str) -> None:
    """The same in all frames, and all light is what it is where nothing is told apart."""
    scan, accuracy = WAYS[way]
    light = light_of(scan, accuracy)
    times, _ = times_of(scan, CLOCK, None)
    plain = light_of_sequence(SCENE, [scan] * FRAMES, times, SHORT_S, accuracy, 0)
    for frame in range(FRAMES):
        total = light.total(frame)
        np.testing.assert_allclose(total, plain.total(frame), rtol=0, atol=1e-14 * total.max())
        assert np.abs(light.moving[frame]).sum() > 0
    due = dg.simulate(SCENE.without("box"), scan, accuracy, 0)
    if way in ("samples", "flood"):
        np.testing.assert_array_equal(light.static, due.total)
    # Of light with a target one share of it, in either, is for each component.
    apart = np.linalg.norm(light.static - due.total)
    assert apart <= 2 * 0.05 * np.linalg.norm(due.total)
    assert light.static.sum() == pytest.approx(due.total.sum(), rel=0.02)


@pytest.mark.parametrize("way", ["shared", "four bounces"])
def test_its_noise_is_that_of_what_moves(way: str) -> None:
    """Not of all light: with random numbers of its own the scene without movers would bring five times that noise."""
    scan, accuracy = WAYS[way]
    every = [light_of(scan, accuracy, seed) for seed in range(5)]

    def noise(lights: list[np.ndarray]) -> float:
        return float(np.sqrt(np.var(lights, axis=0, ddof=1).sum()))

    moving = noise([light.moving for light in every])
    apart = noise([a.static + a.moving - b.static for a, b in zip(every, every[1:] + every[:1], strict=True)])
    assert moving < 0.06 * np.linalg.norm(np.mean([light.moving for light in every], axis=0))
    assert 3 * moving < apart


def test_a_frame_that_comes_by_itself_is_told_apart_too() -> None:
    path = dg.Path((0.0, 1.0), [(1.5, 0.4, 1.2), (1.0, -0.9, 1.4)])
    scene = room(dg.Part("box", box(), dg.Lambertian(0.6), path=path))
    light = light_of(SCAN, TARGET, scene=scene)
    assert "by themselves" in light.samplers["primary"]
    due = dg.simulate(scene.at(float(light.times_s[2].mean())), SCAN, TARGET, 0)
    np.testing.assert_allclose(light.static + light.moving[2], due.total, rtol=0, atol=1e-14 * due.total.max())
    without = dg.simulate(scene.without("box"), SCAN, TARGET, 0)
    assert light.static.sum() == pytest.approx(without.total.sum(), rel=0.02)


def test_where_everything_moves_all_light_does() -> None:
    wall = dg.Part("wall", plate(0, 2), dg.Lambertian(0.8), path=dg.Path((0.0, 1.0), [(0, 0, 0), (0, 0.1, 0)]))
    thing = dg.Part("box", box((0.4, 0.4, 0.6)), dg.Lambertian(0.6), path=PATH)
    light = light_of(SCAN, TARGET, scene=dg.Scene.from_parts([wall, thing]))
    assert not light.static.any() and light.moving.any()


WALK = {"kind": "walk", "speed_m_s": 1.0}


def settings(**changes: Any) -> dict[str, Any]:
    return {
        "scenes": 2, "seed": 4, "transport": {"target": 0.1}, "sequence": {"frames": 3, "rate_hz": 5},
        "scene": {"contents": [{"kind": "box", "motion": WALK}, {"kind": "box", "name": "still"}]},
        "capture": {"scan": {"rows": 2, "columns": 3}, "time": {"bins": 64, "bin_width_ps": 800}},
        "detector": {"cycles": 10_000}, "labels": {"rows": 6, "columns": 6},
        "store": {"fields": ["histogram", "transient", "moving_transient"]},
    } | changes  # fmt: skip


def test_it_is_stored_read_exported_and_replayed(tmp_path: Path) -> None:
    path = tmp_path / "set.zarr"
    dg.build(config_from_mapping(settings()), path, progress=False)
    assert verify(path, deep=True).problems == ()
    field = read_manifest(path).schema.by_name["moving_transient"]
    assert field.dims == ("scene", "frame", "laser", "pixel", "bin") and field.shape == (3, 6, 1, 64)
    fields = ("transient", "moving_transient")
    whole = dg.TransientDataset(path, fields)[1]
    moving = whole["moving_transient"].double()
    still = whole["transient"].double() - moving
    scale = float(whole["transient"].max())
    assert float((still - still[:1]).abs().max()) < 1e-6 * scale
    np.testing.assert_array_equal(moving, dg.replay(path, 1).arrays["moving_transient"].astype(np.float32))
    windows = dg.TransientDataset(path, fields, frames=2, frame_step=1, lasers=[4, 1], bins=slice(3, 30))
    np.testing.assert_array_equal(windows[3]["moving_transient"], whole["moving_transient"][1:, [4, 1], :, 3:30])
    assert windows.time_of("moving_transient").bins == 27
    with np.load(export(path, tmp_path / "npz", "npz", [1])[0]) as file:
        np.testing.assert_array_equal(file["moving_transient"], whole["moving_transient"])
    assert len(export(path, tmp_path / "mat", "mat", [1], field="moving_transient")) == 3
    plan = plan_build(config_from_mapping(settings()), seconds=0.1)
    assert plan.pilots.stored["moving_transient"] > 1000


@pytest.mark.parametrize(("changes", "words"), [
    ({"sequence": None, "scene": {"contents": [{"kind": "box"}]}}, "'moving_transient' without sequence"),
    ({"capture": {"motion": {"kind": "hand"}}}, "'moving_transient' with capture.motion: all light changes"),
])  # fmt: skip
def test_where_nothing_or_everything_changes_it_is_refused_in_one_line(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=f"store.fields: {words}.*leave the field out") as caught:
        config_from_mapping(settings(**changes))
    assert "\n" not in str(caught.value)
