"""Glossy and retroreflecting bodies of many facets, compared with the sum over all of their facets.

For a confocal scan the primary of a body before a matt wall is Σ over its facets of (ρ₁/π)² cos²θ₁ cos²θ₂ f₂ V / R⁴,
each facet cut into pieces that resolve its lobe. Facets whose light is evaluated at few points look dark at every
refinement where lobes pass between these points: a claim that is compared with finer elements alone would then be
kept by wrong light.
"""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from every_brdf import BROAD, KINDS

import datagen as dg
from datagen.transport.brdf import MaterialTable
from datagen.transport.rays import Raycaster
from datagen.transport.reference import brdf
from tests.rooms import bins_of_path, rectangle, square_pixels

MESHES = Path(__file__).parents[3] / "shared" / "meshes"
DEVICE, ALBEDO = np.array([1.2, 0.16, 1.8]), 0.7
PIXEL_M, APERTURE_M = 2e-4, 0.02
POINTS = np.array([(0.0, y, 1.4 + z) for y in np.linspace(-0.7, 0.7, 6) for z in np.linspace(-0.7, 0.7, 6)])
BODY = (0.95, -0.5, 0.6)
MATERIALS = [
    *(dg.Phong(0.5, exponent=n, specular=1) for n in (5, 30, 100, 300, 1000)),
    dg.Phong(0.5, exponent=1000, specular=0.5),
    *(dg.GGX(0.5, roughness) for roughness in (0.1, 0.15, 0.2, 0.3)),
    *(dg.Retroreflector(0.5, half_width_rad=width) for width in (0.0087, 0.05)),
    *BROAD.values(),
]
"""Narrow lobes, and materials of every kind."""
BY_DAY = [*MATERIALS[1:12:4], *(next(iter(kind.broad.values())) for kind in KINDS.values())]


def ball() -> trimesh.Trimesh:
    return trimesh.creation.icosphere(2, radius=0.25).apply_translation(BODY)


def mesh(name: str) -> trimesh.Trimesh:
    """A real mesh, half a metre large, at the place of the ball."""
    if not (MESHES / name).is_file():
        pytest.skip(
            f"{name}: real meshes are not part of the repository; put it into shared/meshes beside the checkout"
        )
    body = trimesh.load(MESHES / name, force="mesh", process=True)
    body.merge_vertices(merge_tex=True, merge_norm=True)
    body.apply_scale(0.5 / body.extents.max())
    return body.apply_translation(BODY - body.bounds.mean(axis=0))


def pieces(corners: np.ndarray, times: int) -> np.ndarray:
    for _ in range(times):
        a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        corners = np.concatenate([np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
    return corners


def facet_sum(scene: dg.Scene, body: trimesh.Trimesh, times: int) -> np.ndarray:
    """(36,) photons of the body at each laser point, each facet cut into 4^times pieces."""
    corners = pieces(np.asarray(body.triangles), times)
    middle = corners.mean(axis=1)
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(doubled, axis=1)
    normal, caster, table = doubled / length[:, None], Raycaster(scene), MaterialTable.of(scene.materials)
    part, found = np.ones(len(middle), np.int64), []
    for x in POINTS:
        span = middle - x
        r = np.linalg.norm(span, axis=1)
        w = span / r[:, None]
        up, side = w[:, 0], -np.einsum("nk,nk->n", w, normal)
        outward = normal * np.sign(side)[:, None]
        hidden = caster.occluded(x + caster.offset_m * np.array([1.0, 0, 0]), middle + caster.offset_m * outward)
        f = brdf(table.kind, table.values, part, outward, -w, -w)
        each = (ALBEDO / np.pi) ** 2 * up**2 * side**2 * f / r**4 * length / 2
        to_device = DEVICE - x
        leg = np.linalg.norm(to_device)
        seen = np.pi * APERTURE_M**2 * to_device[0] / leg**3 * PIXEL_M**2
        found.append(seen * each[~hidden & (up > 0)].sum())
    return np.array(found)


def scene_of(body: trimesh.Trimesh, material: dg.Lambertian) -> tuple[dg.Scene, dg.Capture]:
    wall = rectangle((0, 0, 1.4), (0, 1.2, 0), (0, 0, 1.4))
    scene = dg.Scene.from_parts([dg.Part("relay_wall", wall, dg.Lambertian(ALBEDO)), dg.Part("body", body, material)])
    sensor = dg.Sensor(DEVICE, square_pixels(POINTS, PIXEL_M / 2), aperture_radius_m=APERTURE_M)
    return scene, dg.Capture(dg.Laser(DEVICE, POINTS), sensor, bins_of_path(400, 0.03, 0.0), pairing="confocal")


def check(body: trimesh.Trimesh, material, times: int, seeds, targets=(0.02, 0.005)) -> None:
    """The energy is right within the noise allowed; the L2 error is within the target except in one run, and
    there within twice the target.

    The claimed error is an estimate at 98 %, from some of the laser points.
    """
    scene, capture = scene_of(body, material)
    truth = facet_sum(scene, body, times)
    beyond = []
    for target in targets:
        for seed in seeds:
            run = dg.simulate(scene, capture, dg.Accuracy(target=target), seed=seed)
            energy = run.total.sum(axis=(1, 2)) + run.overflow.sum(axis=1)
            # Light is sampled: the energy of all points has a part of the error of each.
            assert energy.sum() == pytest.approx(truth.sum(), rel=0.75 * target, abs=0), (material, target, seed)
            # The truth is a sum that is right to a few thousandths for the narrowest lobes.
            off = np.linalg.norm(energy - truth) / np.linalg.norm(truth) / max(target, 0.006)
            beyond.append(off)
            assert run.relative_error < 2.0 * target
    assert sorted(beyond)[-2:][0] <= 1.0 and max(beyond) <= 2.0, (material, beyond)


@pytest.mark.parametrize("material", BY_DAY, ids=repr)
def test_a_ball_has_all_its_light(material):
    check(ball(), material, 4, [0, 1], (0.02,))


@pytest.mark.nightly
@pytest.mark.parametrize("material", MATERIALS, ids=repr)
def test_a_ball_has_all_its_light_at_every_seed_and_target(material):
    check(ball(), material, 5, range(3))


@pytest.mark.nightly
@pytest.mark.parametrize("material", MATERIALS, ids=repr)
@pytest.mark.parametrize("name", ["spot.obj", "teapot.obj", "stanford-bunny.obj"])
def test_real_meshes_have_all_their_light(name, material):
    body = mesh(name)
    check(body, material, 2 if len(body.faces) < 10_000 else 1, range(3), (0.02,))
