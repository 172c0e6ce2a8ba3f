"""Evidence of objects in plain sight counts all light by way of them: in closed form, and as the detections that are
lost without the object."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from rooms import rectangle

import datagen as dg
from datagen.evidence import light_in_sight
from datagen.evidence.in_sight import objects_in_sight
from datagen.transport.rays import Raycaster

pytestmark = pytest.mark.usefixtures("builds_here")

EYE = np.array([2.0, 0.0, 0.0])
TIME = dg.TimeAxis(bins=80, width_s=4e-10)
IDEAL = dg.Spad(pde=0.25, mode="ideal")
EXPOSURE = dg.Exposure(cycles=10**4, photons_per_pulse=1e9)
WALL = dg.Part("relay_wall", rectangle((0, -1.2, 0), (0, 1.0, 0), (0, 0, 1.0)), dg.Lambertian(0.8), "relay_wall")


def plate(albedo: float = 0.6, x: float = 0.4, half_m: float = 0.3) -> dg.Part:
    """A plate beside the wall that faces the device; nothing is behind it, so it shadows nothing."""
    return dg.Part("plate", rectangle((x, 0.6, 0), (0, half_m, 0), (0, 0, half_m)), dg.Lambertian(albedo))


def capture(
    targets: list[tuple[float, float, float]], seen: list[tuple[float, float, float]], **how: str
) -> dg.Capture:
    pixels = np.array(seen)[:, None] + 0.08 * np.array([[0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1.0]])
    return dg.Capture(dg.Laser(EYE, targets), dg.Sensor(EYE, pixels), TIME, **how)  # type: ignore[arg-type]


def evidence(scene: dg.Scene, looked: dg.Capture, accuracy: dg.Accuracy, spad: dg.Spad = IDEAL) -> dg.Evidence:
    t = dg.simulate(scene, looked, accuracy, seed=1)
    plain = light_in_sight(scene, looked, accuracy, seed=1)
    return dg.own_evidence(t, spad, EXPOSURE, ["plate"], in_sight=plain)["plate"]


def test_one_bounce_in_closed_form() -> None:
    """A laser point on a plate inside a pixel: ρ/π cosθ A/R² photons, and no other light."""
    at = np.array([0.4, 0.6, 0.0])
    scene, looked = dg.Scene.from_parts([plate()]), capture([tuple(at)], [tuple(at)])
    found = evidence(scene, looked, dg.Accuracy(samples=64, max_bounces=3, direct=True))
    span = EYE - at
    cosine = span[0] / np.linalg.norm(span)
    photons = 0.6 / np.pi * cosine * looked.sensor.aperture_area_m2 / (span @ span)
    counted = photons * IDEAL.pde * EXPOSURE.photons_per_pulse * EXPOSURE.cycles
    assert found.detections == pytest.approx(counted, rel=1e-6)
    assert found.brightest_bin == pytest.approx(counted, rel=1e-6)
    assert found.significance == pytest.approx(np.sqrt(counted), rel=1e-6)


CASES = {
    "laser on the plate, pixel on the plate": ([(0.4, 0.6, 0.0)], [(0.4, 0.6, 0.0)]),
    "laser on the wall, pixel on the plate": ([(0.0, -0.5, 0.0)], [(0.4, 0.6, 0.0)]),
    "laser on the plate, pixel on the wall": ([(0.4, 0.6, 0.0)], [(0.0, -0.5, 0.0)]),
    "laser on the wall, pixel half on the plate": ([(0.0, -0.5, 0.0)], [(0.4, 0.9, 0.0)]),
    "a scan of both": ([(0.4, 0.57, 0.03), (0.0, -0.5, 0.1)], [(0.4, 0.6, 0.0), (0.0, -0.6, 0.0)]),
}


@pytest.mark.parametrize(("illumination", "direct"), [("scan", True), ("scan", False), ("flood", True)])
@pytest.mark.parametrize("case", CASES)
def test_evidence_is_the_loss_of_detections_without_the_object(case: str, illumination: str, direct: bool) -> None:
    """To 3 %, the sampling error of both, for an object that shadows nothing and a detector without dead time. The
    plate is turned a little towards the wall, so that there is light of two and three bounces between the two."""
    looked = capture(*CASES[case], illumination=illumination)
    turned = trimesh.Trimesh(
        [(0.4, 0.3, -0.3), (0.9, 0.9, -0.3), (0.9, 0.9, 0.3), (0.4, 0.3, 0.3)], [(0, 1, 2), (0, 2, 3)], process=False
    )
    scene = dg.Scene.from_parts([WALL, dg.Part("plate", turned, dg.Lambertian(0.6))])
    accuracy = dg.Accuracy(samples=8192, max_bounces=3, direct=direct)
    means = [
        dg.expected_histogram(dg.simulate(s, looked, accuracy, seed=2).total, TIME, IDEAL, EXPOSURE).sum()
        for s in (scene, scene.without("plate"))
    ]
    found = evidence(scene, looked, accuracy)
    if means[0] == means[1]:
        assert found.detections == 0
    else:
        assert found.detections == pytest.approx(means[0] - means[1], rel=0.03)


def test_with_a_target_all_light_is_counted_as_well() -> None:
    scene = dg.Scene.from_parts([WALL, plate()])
    looked = capture(*CASES["a scan of both"])
    by_target = evidence(scene, looked, dg.Accuracy(target=0.05, direct=True, max_bounces=3))
    by_samples = evidence(scene, looked, dg.Accuracy(samples=8192, max_bounces=3, direct=True))
    assert by_target.detections == pytest.approx(by_samples.detections, rel=1e-3)
    three = dg.own_evidence(dg.simulate(scene, looked, dg.Accuracy(target=0.05, direct=True)), IDEAL, EXPOSURE)
    assert by_target.detections > 20 * three["plate"].detections


def test_light_of_several_objects_is_separated() -> None:
    """Light that one object reflects to the sensor does not count for the other, unless it touched both."""
    other = dg.Part("other", rectangle((0.4, 1.6, 0), (0, 0.3, 0), (0, 0, 0.3)), dg.Lambertian(0.6))
    scene = dg.Scene.from_parts([plate(), other])
    looked = capture([(0.4, 0.6, 0.0), (0.4, 1.6, 0.0)], [(0.4, 0.6, 0.0), (0.4, 1.6, 0.0)], pairing="confocal")
    found = light_in_sight(scene, looked, dg.Accuracy(samples=64, max_bounces=3, direct=True))
    assert found["plate"][0].sum() > 0 and found["plate"][1].sum() == 0
    assert found["other"][1].sum() > 0 and found["other"][0].sum() == 0


def test_small_objects_between_the_lines_of_sight_are_found() -> None:
    for half_m in (0.1, 0.01, 0.001):
        scene = dg.Scene.from_parts([WALL, plate(half_m=half_m)])
        looked = capture([(0.0, -0.5, 0.0)], [(0.4, 0.571, 0.033)])
        assert objects_in_sight(scene, looked, Raycaster(scene)) == ("plate",)


def test_hidden_objects_have_no_light_in_sight() -> None:
    """Behind a screen, and beside every pixel: nothing is simulated for them, and their evidence is as it was."""
    screen = dg.Part("screen", rectangle((1.0, 0.6, 0), (0, 0.4, 0), (0, 0, 0.4)), dg.Lambertian(0.1), "structure")
    looked = capture([(0.0, -0.5, 0.0)], [(0.4, 0.6, 0.0), (0.0, -0.7, 0.1)])
    hidden = dg.Scene.from_parts([WALL, plate(), screen])
    assert light_in_sight(hidden, looked, dg.Accuracy(direct=True)) == {}
    beside = dg.Scene.from_parts([WALL, plate()])
    assert light_in_sight(beside, capture([(0.0, -0.5, 0.0)], [(0.0, -0.7, 0.1)]), dg.Accuracy(direct=True)) == {}


def test_scenes_of_ready_configurations_hide_their_objects() -> None:
    for name in ("zone_sensor", "spad_array", "open_space_meshes", "furnished_rooms"):
        config = dg.load_config(f"configs/{name}.yaml")
        scene = dg.scene_for(config, 1)
        assert objects_in_sight(scene, dg.capture_for(config, scene, config.seed, 1), Raycaster(scene)) == (), name


def test_datasets_store_evidence_of_objects_in_plain_sight(tmp_path: Path) -> None:
    scene, looked = dg.Scene.from_parts([WALL, plate()]), capture(*CASES["a scan of both"])
    settings = {
        "transport": {"samples": 2048, "direct": True, "max_bounces": 3},
        "detector": {"mode": "ideal", "cycles": 10_000, "photons_per_pulse": 1e9},
        "store": {"histogram_dtype": "uint32"},
    }
    dg.build_from([scene], tmp_path / "set", looked, settings=settings, progress=False)
    data = dg.TransientDataset(tmp_path / "set", ("histogram",), counts="stored")
    stored = float(data.parameters("evidence.plate.detections")[0])
    wanted = evidence(scene, looked, dg.Accuracy(samples=2048, max_bounces=3, direct=True))
    pde = float(data.parameters("detector.pde")[0])
    assert stored == pytest.approx(wanted.detections * pde / IDEAL.pde, rel=1e-3)
    assert stored > 0.9 * float(data[0]["histogram"].sum())
