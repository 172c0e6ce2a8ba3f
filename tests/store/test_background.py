"""The fields of the background: the same room without its objects, measured by the same device with other noise."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from datasets import write_dataset
from rooms import rectangle
from scipy import stats

import datagen as dg
from datagen.building.resimulate import resimulate
from datagen.config import config_from_mapping
from datagen.formats import export
from datagen.pipeline import sample_of, simulate_sample
from datagen.records import Rectangle
from datagen.store import verify

pytestmark = pytest.mark.usefixtures("builds_here")

BACKGROUND = ("background_histogram", "background_transient")
FIELDS = ("histogram", "transient", "depth", *BACKGROUND)


def config(transport: dict[str, Any] | None = None, fields: tuple[str, ...] = FIELDS) -> dg.DatasetConfig:
    return config_from_mapping(
        {
            "seed": 5,
            "scenes": 3,
            "scene": {"layout": {"kind": "l_corridor"}, "contents": [{"kind": "box", "count": {"choice": [1, 2]}}]},
            "capture": {"scan": {"rows": 2, "columns": 2}, "time": {"bins": 96, "bin_width_ps": 600}},
            "transport": transport or {"target": 0.1},
            # Decided for the room with its objects, effects may be others than for the room without.
            "effects": {"pile_up": "on"},
            "detector": {"cycles": 30_000, "ambient_rate_hz": 1e6, "dead_time_ns": 40},
            "labels": {"rows": 4, "columns": 4},
            "store": {"fields": list(fields), "scenes_per_shard": 2},
        }
    )


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_dataset(config(), tmp_path_factory.mktemp("background") / "set")


def plate(x: float, half: float) -> trimesh.Trimesh:
    return rectangle((x, 0, 0), (0, half, 0), (0, 0, half))


def room(albedo: float | None) -> dg.Scene:
    """A wall, another 2 m behind it, and between them a plate of an albedo, or none."""
    parts = [
        dg.Part("relay_wall", plate(0, 2), dg.Lambertian(0.8), "relay_wall"),
        dg.Part("back", plate(2, 2), dg.Lambertian(0.8), "structure"),
    ]
    if albedo is not None:
        parts.append(dg.Part("plate", plate(1, 0.3), dg.Lambertian(albedo)))
    return dg.Scene.from_parts(parts, relay_wall=Rectangle.of((0, 0, 0), (0, 1, 0), (0, 0, 1)))


def capture() -> dg.Capture:
    place, points = (1.5, -1.5, 0.0), [(0, 0.2, 0.2), (0, -0.2, 0.3)]
    sensor = dg.Sensor.grid(place, (0, 0.1, 0), (0, 0.1, 0), (0, 0, 0.1), rows=1, columns=2)
    return dg.Capture(dg.Laser(place, points), sensor, dg.TimeAxis(bins=120, width_s=2e-10, origin="wall"))


@pytest.mark.parametrize("transport", [{"target": 0.1}, {"samples": 256, "max_bounces": None}])
def test_the_background_is_the_room_without_its_objects_bit_for_bit(transport: dict[str, Any]) -> None:
    given = config(transport)
    scene = dg.generate_scene(given.scene, given.seed, 0)
    capture = dg.capture_for(given, scene, given.seed, 0)
    emptied = scene.without(*scene.objects)
    assert scene.objects and not emptied.objects
    full, empty = (sample_of(given, 0, room, capture) for room in (scene, emptied))
    assert np.array_equal(full.arrays["background_transient"], empty.arrays["transient"])
    assert np.array_equal(empty.arrays["background_transient"], empty.arrays["transient"])
    assert not np.array_equal(full.arrays["transient"], empty.arrays["transient"])
    # The same mean, and noise of its own: one stream for both would make them equal.
    assert np.array_equal(full.arrays["background_histogram"], empty.arrays["background_histogram"])
    a, b = (empty.arrays[name].astype(float) for name in ("histogram", "background_histogram"))
    seen = a + b > 8
    chi2 = float((((a - b) ** 2)[seen] / (a + b)[seen]).sum())
    low, high = stats.chi2.ppf([1e-6, 1 - 1e-6], seen.sum())
    assert seen.sum() > 50 and low < chi2 < high


def test_without_a_part_is_as_if_it_had_never_been_there() -> None:
    emptied, never = room(0.5).without("plate"), room(None)
    for name in ("vertices", "triangles", "face_part"):
        assert np.array_equal(getattr(emptied, name), getattr(never, name))
    assert (emptied.part_names, emptied.roles) == (never.part_names, never.roles)
    assert room(0.5).without("back").objects == ("plate",)
    for names, message in ((("door",), "'door'"), (("relay_wall", "back", "plate"), "at least one surface")):
        with pytest.raises(dg.InputError, match=message):
            room(0.5).without(*names)


@pytest.mark.parametrize("albedo", [0.0, 0.8])
def test_the_difference_is_the_objects_own_light_and_its_shadow(albedo: float) -> None:
    """Of every pair of laser point and pixel; of three bounces, within three claimed errors of all three lights."""
    time = {"bins": 120, "bin_width_ps": 200, "origin": "wall"}
    shape = {"scan": {"rows": 2, "columns": 1}, "field_of_view": {"rows": 1, "columns": 2}, "pairing": "exhaustive"}
    given = config_from_mapping(
        {
            "capture": {"time": time, **shape},
            "transport": {"target": 0.03, "max_bounces": 3},
            "store": {"fields": ["histogram", "transient", *BACKGROUND]},
        }
    )
    found = sample_of(given, 0, room(albedo), capture()).arrays
    own = dg.simulate(room(albedo), capture(), dg.Accuracy(target=0.03, max_bounces=3), seed=1).parts["plate"]
    difference = found["transient"] - found["background_transient"]
    assert ((difference - own).sum(axis=-1) < -0.02 * found["transient"].sum(axis=-1)).all(), "it casts a shadow"
    assert ((difference.sum(axis=-1) > 0) == (albedo > 0)).all()
    # Whatever the plate keeps away has been to the back wall: of earlier bins all of the difference is its own.
    early = capture().time.edges_s[1:] <= 2 * 2.0 / 299_792_458
    claimed = np.hypot(0.03 * np.sqrt(2) * np.linalg.norm(found["transient"]), 0.075 * np.linalg.norm(own))
    assert np.linalg.norm((difference - own)[..., early]) <= 3 * claimed


def test_a_dataset_has_it_everywhere_and_nothing_else_changes(built: Path, tmp_path: Path) -> None:
    assert verify(built, deep=True).problems == () and resimulate(built, 1)[1] == []
    plain, more = (simulate_sample(config(fields=fields), 1) for fields in (FIELDS[:3], FIELDS))
    assert set(more.arrays) - set(plain.arrays) == {*BACKGROUND}
    assert all(np.array_equal(more.arrays[name], values) for name, values in plain.arrays.items())
    assert more.parameters == plain.parameters
    data = dg.TransientDataset(built, FIELDS)
    assert data.stats["background_histogram"]["mean"] > 0
    assert "background_histogram" in (built / "README.md").read_text()
    (file,) = export(built, tmp_path, "npz", scenes="1")
    with np.load(file) as stored:
        for name in BACKGROUND:
            assert np.array_equal(stored[name], data[1][name].numpy())
            assert np.array_equal(stored[name], more.arrays[name].astype(stored[name].dtype))


def test_fresh_noise_is_that_of_both(built: Path) -> None:
    names = ("histogram", "background_histogram")
    both, alone = (dg.TransientDataset(built, fields, redraw_noise=True) for fields in (names, names[:1]))
    drawn = [both[0] for _ in range(3)]
    assert np.array_equal(drawn[0]["histogram"], alone[0]["histogram"])
    backgrounds = [dg.TransientDataset(built, names)[0], *drawn]
    assert len({tuple(of["background_histogram"].flatten().tolist()) for of in backgrounds}) == 4
    assert "background_histogram, drawn anew at every read" in repr(both)


def test_a_transient_from_elsewhere_has_none(tmp_path: Path) -> None:
    """Its presence is unknown, too."""
    item = (room(0.5), capture(), np.zeros(capture().shape))
    with pytest.raises(dg.InputError, match="fields: a background is simulated, and a transient given tells nothing"):
        dg.build_from([item], tmp_path / "set", fields=("histogram", "background_histogram"), progress=False)
    quick = {"transport": {"target": 0.3, "max_bounces": 3}}
    scenes = [item, (room(0.5), capture())]
    dg.build_from(scenes, tmp_path / "set", fields=("histogram", "presence"), settings=quick, progress=False)
    unknown, known = (item["object_presence"] for item in dg.TransientDataset(tmp_path / "set", ("object_presence",)))
    assert unknown.isnan().all() and (known > 0).all()
