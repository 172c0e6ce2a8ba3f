"""The short cuts of the quadrature kernel give the light of the plain way: every shadow ray cast, every bin
integrated."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import trimesh
from rooms import bins_of_path, furnished_box, one_point_capture, rectangle

from datagen import Accuracy, Capture, Lambertian, OrenNayar, Part, Scene
from datagen.records.materials import Material
from datagen.transport.quadrature.arrival_times import spread
from datagen.transport.quadrature.gathering import Gathering
from datagen.transport.reference import pairs_of
from datagen.transport.simulate import prepared
from datagen.transport.visibility.bvh import Hierarchy
from datagen.transport.visibility.occluder_rows import Occluders
from datagen.transport.visibility.occlusion import LISTED, SUSPECT, hidden, lists, narrowed


def cluttered() -> Scene:
    """A wall, a ball, two boxes that intersect, a ring turned inside out, a ring whose triangles share no vertices, a
    ball with a dent through its other side, and a box without a lid."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.3)
    ball.apply_translation((1.2, 0.3, 0.4))
    box = trimesh.creation.box(bounds=[(0.9, -0.5, -0.3), (1.3, -0.1, 0.3)])
    inside = trimesh.creation.box(bounds=[(1.1, -0.3, 0.0), (1.6, 0.4, 0.2)])
    opened = trimesh.creation.box(bounds=[(0.6, 0.4, -0.6), (0.9, 0.8, -0.3)])
    opened.update_faces(opened.triangles_center[:, 0] > 0.61)
    ring = trimesh.creation.torus(0.25, 0.1, 12, 8)
    ring.apply_transform(trimesh.transformations.euler_matrix(0.4, 1.2, 0.3))
    ring.apply_translation((0.8, 0.0, 0.6))
    apart = np.asarray(ring.triangles).reshape(-1, 3) + np.array((0.5, -0.6, -0.2))
    loose = trimesh.Trimesh(apart, np.arange(len(apart)).reshape(-1, 3), process=False)
    inverted = trimesh.Trimesh(ring.vertices, ring.faces[:, ::-1], process=False)
    dented = trimesh.creation.icosphere(subdivisions=2, radius=0.25)
    dented.vertices[np.argmax(dented.vertices[:, 2])] -= (0, 0, 0.6)
    dented.apply_translation((1.1, 0.6, -0.3))
    wall = Part("wall", rectangle((0, 0, 0), (0, 1, 0), (0, 0, 1)), Lambertian(0.8), "relay_wall")
    behind = Part("behind", rectangle((2, 0, 0), (0, -1, 0), (0, 0, 1)), Lambertian(0.7), "structure")
    meshes = {"ball": ball, "box": box, "inside": inside, "ring": inverted, "loose": loose, "dented": dented,
              "opened": opened}  # fmt: skip
    return Scene.from_parts([wall, behind, *(Part(name, mesh, Lambertian(0.6)) for name, mesh in meshes.items())])


def crossed(x: np.ndarray, y: np.ndarray, corners: np.ndarray, own: np.ndarray) -> np.ndarray:
    """(n,) whether any triangle other than triangle `own` crosses the open line from x to y, in plain algebra."""
    d = y - x
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    system = np.stack([np.broadcast_to(b - a, (len(x), *a.shape)), np.broadcast_to(c - a, (len(x), *a.shape)),
                       np.broadcast_to(-d[:, None], (len(x), *a.shape))], axis=-1)  # fmt: skip
    u, v, t = np.moveaxis(np.linalg.solve(system, (x[:, None] - a)[..., None])[..., 0], -1, 0)
    hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 1e-9) & (t < 1 - 1e-9)
    hit[np.arange(len(x)), own] = False
    return np.asarray(hit.any(axis=1))


def drawn(tree: Hierarchy, n: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points x in front of the scene, triangles, and small elements (n, 3, 3) on these."""
    rng = np.random.default_rng(seed)
    x = rng.uniform((0.0, -1, -1), (0.3, 1, 1), (n, 3))
    own = rng.integers(len(tree.corners), size=n)
    middle = rng.dirichlet((1, 1, 1), n)
    shares = middle[:, None] * 0.7 + 0.3 * rng.dirichlet((1, 1, 1), (n, 3))
    return x, own, np.einsum("nvk,nki->nvi", shares, tree.corners[own])


def test_candidates_hide_what_all_triangles_do() -> None:
    """Shadow rays that test only the candidates handed down to an element give the answer of plain algebra over all
    triangles; and if no candidate is left, nothing hides any point of the element."""
    scene = cluttered()
    tree = Hierarchy.of(scene)
    hides = Occluders.of(scene, tree)
    x, own, cell = drawn(tree, 600, 1)
    listed, found, clear = lists(4096), list[list[int]](), 0
    shares = np.random.default_rng(2).dirichlet((1, 1, 1), (600, 8))
    points = np.einsum("npv,nvi->npi", shares, cell)
    for i in range(600):
        eye, of = tuple(x[i]), int(own[i])
        corners, end = (tuple(cell[i, v]) for v in range(3)), LISTED + 1
        last = narrowed(eye, *corners, of, LISTED, end, end, hides.row, listed)
        clear += last == end
        for first, behind in ((LISTED, end), (end, last)):
            listed[SUSPECT] = 0
            found.append([hidden(eye, tuple(y), of, first, behind, hides.row, listed) for y in points[i]])
    answers = np.array(found).reshape(600, 2, 8) > 0
    truth = crossed(np.repeat(x, 8, axis=0), points.reshape(-1, 3), tree.corners, np.repeat(own, 8)).reshape(600, 8)
    assert (answers == truth[:, None]).all()
    assert 20 < clear < 500
    assert 0.1 < truth.mean() < 0.9


def histograms(scene: Scene, capture: Capture, occlusion: str, error: float) -> tuple[np.ndarray, int, int]:
    accuracy = Accuracy(target=0.02, occlusion=occlusion)  # type: ignore[arg-type]
    gathering = Gathering.of(prepared(scene, capture, accuracy, 0, split_parts=True))
    pairs, parts = pairs_of(gathering.task.capture), len(scene.part_names)
    seen = list(gathering.seen(pairs, 1))
    coarse = gathering.gathered(pairs, seen, np.full(parts, 1e300), np.arange(parts)).histogram
    allowed = error * np.maximum(np.linalg.norm(coarse, axis=(0, 2)), 1e-3 * np.linalg.norm(coarse))
    found = gathering.gathered(pairs, seen, allowed, np.arange(parts))
    return found.histogram, int(found.cells.sum()), int(found.rays.sum())


def within_a_ring() -> Scene:
    """A ring whose bounding box contains the laser point but not the pixel."""
    ring = trimesh.creation.torus(0.3, 0.08, 24, 12)
    ring.apply_transform(trimesh.transformations.euler_matrix(0.2, 1.4, 0.1))
    ring.apply_translation((0.05, -0.3, 0.5))
    return Scene.from_parts(
        [Part("wall", rectangle((0, 0, 0), (0, 1, 0), (0, 0, 1)), Lambertian(0.8), "relay_wall"),
         Part("behind", rectangle((1, 0, 0), (0, -1, 0), (0, 0, 1)), Lambertian(0.7), "structure"),
         Part("ring", ring, Lambertian(0.6))]
    )  # fmt: skip


def touching() -> Scene:
    """Boxes that stand on each other, with edges where points of elements lie."""
    wall = Part("wall", rectangle((0, 0, 0), (0, 1, 0), (0, 0, 1)), Lambertian(0.8), "relay_wall")
    third = 0.4 / 3
    bounds = [[(1.0, -0.4, -0.4), (1.4, 0.4, 0.4)], [(0.8, -third, 0.0), (1.0, third, third)],
              [(0.8, -0.4, -0.4), (1.0, 0.4, -2 * third)], [(0.9, 0.0, -third), (1.0, third, 0.0)],
              [(0.8, third, 0.0), (1.0, 2 * third, 2 * third)]]  # fmt: skip
    shelf = trimesh.util.concatenate([trimesh.creation.box(bounds=ends) for ends in bounds])
    shelf.apply_transform(trimesh.transformations.euler_matrix(0.0, 0.0, 0.37))
    shelf.apply_translation((0.0123, 0.0345, 0.0567))
    return Scene.from_parts([wall, Part("shelf", shelf, Lambertian(0.6))])


@pytest.mark.parametrize(
    ("scene", "share"),
    [(cluttered, 1.0), (furnished_box, 0.8), (within_a_ring, 1.0), (touching, 0.8)],
    ids=lambda given: getattr(given, "__name__", "of rays"),
)  # fmt: skip
@pytest.mark.parametrize("half_side_m", [1e-3, 0.2])
def test_proofs_save_rays_and_change_little(
    scene: Callable[[], Scene], share: float, half_side_m: float
) -> None:  # fmt: skip
    """The light of each part with rays saved is that with all rays cast, apart from a rare element that the three
    rays miss, and from what elements that are not proven to be clear gain by being cut finer."""
    room = scene()
    capture = one_point_capture(
        (0, -0.3, 0.5), (0, 0.4, 0.6), half_side_m, bins_of_path(200, 0.02, 0.0), (0.4, 0.1, 0.9)
    )
    fast, _, rays = histograms(room, capture, "auto", 1e-3)
    plain, _, all_rays = histograms(room, capture, "on", 1e-3)
    norm = np.linalg.norm(plain, axis=(0, 2))
    assert norm.max() > 0
    # The error that ten elements may make.
    assert (np.linalg.norm(fast - plain, axis=(0, 2)) <= 1e-2 * np.maximum(norm, 1e-3 * norm.max())).all()
    assert rays < share * all_rays


@pytest.mark.parametrize("seed", range(3))
def test_a_tent_is_the_integral_of_its_light(seed: int) -> None:
    """The bins equal sums over a million points of the triangle: inside the window, across both of its ends, steep
    and flat."""
    rng = np.random.default_rng(seed)
    n, bins = 1000, 12
    u, v = (np.stack(np.meshgrid(np.arange(n), np.arange(n))).reshape(2, -1) + 0.5) / n
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    for width in (1e-3, 0.4, 3.0, 30.0):
        times, weights = rng.uniform(-4, 16) + width * rng.uniform(0, 1, 3), rng.uniform(0, 1, 3)
        row = np.zeros((2, bins))
        outside = spread(row, 1, *times, *weights, 2.0)
        at = times[0] + u * (times[1] - times[0]) + v * (times[2] - times[0])
        w = weights[0] + u * (weights[1] - weights[0]) + v * (weights[2] - weights[0])
        truth = 2.0 * np.histogram(at, bins, (0, bins), weights=w)[0] / w.sum()
        assert not row[0].any()
        np.testing.assert_allclose(row[1], truth, atol=6e-3)
        assert row.sum() + outside == pytest.approx(2.0, rel=1e-12)
    assert spread(row, 0, np.nan, 1.0, 2.0, *weights, 2.0) == 2.0


@pytest.mark.parametrize(("half_side_m", "origin"), [(1e-3, "wall"), (0.05, "source"), (0.4, "wall")])
def test_cells_taken_together_are_those_taken_one_by_one(half_side_m: float, origin: str) -> None:
    """Lambertian surfaces against surfaces of another model at its Lambertian limit, whose elements are never
    processed in batches: as many elements and rays, and the same light in each bin but for rounding; from a point to
    a wide pixel, in haze, beside a corner, behind a screen and across the ends of the window."""
    places = {
        "wall": ((0, 0, 0), (0, 1, 0), (0, 0, 1)), "behind": ((2, 0, 0), (0, -1, 0), (0, 0, 1)),
        "beside": ((1, -1, 0), (1, 0, 0), (0, 0, 1)), "screen": ((1.2, 0.3, 0.1), (0, -0.3, 0.1), (0, 0, 0.4)),
    }  # fmt: skip
    capture = one_point_capture(
        (0, -0.3, 0.5), (0, 0.4, 0.6), half_side_m, bins_of_path(170, 0.03, 0.9, origin), (0.4, 0.1, 0.9)
    )

    def room(diffuse: Callable[[float], Material]) -> Scene:
        parts = [
            Part(name, rectangle(*place), diffuse(0.6), "relay_wall" if name == "wall" else "structure")
            for name, place in places.items()
        ]
        return Scene.from_parts(parts, attenuation_per_m=0.1)

    together, cells, rays = histograms(room(Lambertian), capture, "auto", 1e-4)
    alone, same_cells, same_rays = histograms(room(lambda albedo: OrenNayar(albedo, 0.0)), capture, "auto", 1e-4)
    assert (cells, rays) == (same_cells, same_rays)
    assert (together.sum(axis=(0, 2))[1:] > 0).all()
    np.testing.assert_allclose(together, alone, rtol=1e-9, atol=1e-12 * alone.max())
