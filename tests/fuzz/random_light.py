"""Random scenes, captures and accuracies for the fuzzer: on coarse lattices things touch, coincide and degenerate.

Coordinates are quarters: vertices fall on one another, triangles lie in one plane, cross, repeat and collapse, laser
points and pixels land on edges and corners, far more often than with continuous numbers. A power of two then scales
the scene and a small shift of some vertices breaks the lattice by a hair.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import trimesh
from every_brdf import KINDS
from fuzz_profile import st
from rooms import rectangle

from datagen import Accuracy, Capture, Lambertian, Laser, Part, Scene, Sensor, TimeAxis
from datagen.records import Material
from datagen.transport.brdf import lobe_width
from datagen.units import SPEED_OF_LIGHT_M_PER_S as C

HAIR_M = (0.0, 0.0, 0.0, 1e-9, 1e-6, 1e-3)
"""By how much vertices leave the lattice; most often not at all."""

quarters = st.integers(-6, 6).map(lambda n: n / 4)
points = st.tuples(quarters, quarters, quarters)
seeds = st.integers(0, 2**32 - 1)
albedos = st.sampled_from([0.0, 1e-9, 0.2, 0.5, 0.9, 1.0])


@dataclass(frozen=True)
class Case:
    """Something to simulate."""

    scene: Scene
    capture: Capture
    accuracy: Accuracy
    seed: int


@st.composite
def materials(draw: st.DrawFn, *, smooth: bool = False) -> Material:
    """Any material; `smooth`: none with a lobe so narrow that random samples hardly meet it."""
    kind = KINDS[draw(st.sampled_from(["lambertian", *KINDS]))]
    known = [material for material in kind.laws + kind.matt if not smooth or lobe_width(material) > 0.6]
    return replace(draw(st.sampled_from(known or KINDS["lambertian"].laws)), albedo=draw(albedos))


@st.composite
def soups(draw: st.DrawFn) -> trimesh.Trimesh:
    """Triangles on the lattice: some without area, some repeated, some turned over."""
    triangles = draw(st.lists(st.tuples(points, points, points), min_size=1, max_size=8))
    vertices = np.array(triangles, float).reshape(-1, 3)
    faces = np.arange(len(vertices)).reshape(-1, 3)
    if draw(st.booleans()):
        faces = np.concatenate([faces, faces[:1, ::-1], faces[:1]])
    return trimesh.Trimesh(vertices, faces, process=False)


@st.composite
def boxes(draw: st.DrawFn) -> trimesh.Trimesh:
    low = np.array(draw(points))
    size = np.array(draw(st.tuples(*[st.sampled_from([0.25, 0.5, 1.0])] * 3)))
    mesh = trimesh.creation.box(size)
    mesh.apply_translation(low + size / 2)
    return mesh


@st.composite
def closed_surfaces(draw: st.DrawFn) -> trimesh.Trimesh:
    """Balls and rings with dents, some of which pass through themselves, turned either way, whole or in loose
    triangles."""
    mesh = draw(st.sampled_from([trimesh.creation.icosphere(1, 0.5), trimesh.creation.torus(0.4, 0.15, 8, 6)]))
    rng, dents = np.random.default_rng(draw(seeds)), draw(st.sampled_from([0.0, 0.05, 0.3]))
    vertices = mesh.vertices + dents * rng.standard_normal(mesh.vertices.shape) + np.array(draw(points))
    faces = mesh.faces[:, ::-1] if draw(st.booleans()) else mesh.faces
    if draw(st.booleans()):
        vertices, faces = vertices[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3)
    return trimesh.Trimesh(vertices, faces, process=False)


@st.composite
def rooms(draw: st.DrawFn) -> list[trimesh.Trimesh]:
    """Walls of −1.5 … 1.5 m in each direction, each a part or all one; some may be missing."""
    sides = draw(st.sets(st.integers(0, 5), min_size=1, max_size=6))
    walls = []
    for side in sorted(sides):
        axis, sign = side // 2, 1.0 - 2.0 * (side % 2)
        e = np.eye(3) * 1.5
        walls.append(rectangle(sign * e[axis], e[(axis + 1) % 3], e[(axis + 2) % 3]))
    return [trimesh.util.concatenate(walls)] if draw(st.booleans()) else walls


@st.composite
def scenes(draw: st.DrawFn, *, smooth: bool = False) -> Scene:
    meshes = draw(rooms()) if draw(st.booleans()) else []
    meshes = meshes + draw(
        st.lists(st.one_of(soups(), boxes(), closed_surfaces()), min_size=0 if meshes else 1, max_size=3)
    )
    hair = draw(st.sampled_from(HAIR_M))
    lambertian = draw(st.booleans())
    rng = np.random.default_rng(draw(seeds)) if hair else None
    parts = []
    for number, mesh in enumerate(meshes):
        vertices = np.asarray(mesh.vertices, float)
        if rng is not None:
            vertices = vertices + hair * rng.standard_normal(vertices.shape)
        moved = trimesh.Trimesh(vertices, mesh.faces, process=False)
        if moved.area_faces.max() < 1e-6:
            moved = rectangle((0, 0, -1.5), (1.5, 0, 0), (0, 1.5, 0))
        material = Lambertian(draw(albedos)) if lambertian else draw(materials(smooth=smooth))
        parts.append(Part(f"part {number}", moved, material, draw(st.sampled_from(["object", "structure"]))))
    return Scene.from_parts(parts, attenuation_per_m=draw(st.sampled_from([0.0, 0.0, 0.3, 50.0])))


@st.composite
def pixels(draw: st.DrawFn) -> np.ndarray:
    """(4, 3) a rectangle about a lattice point, from a hair's breadth to metres across."""
    center = np.array(draw(points))
    axes = np.eye(3)[list(draw(st.permutations([0, 1, 2])))]
    right, up = (draw(st.sampled_from([1e-4, 0.01, 0.25, 1.0])) * axis for axis in axes[:2])
    return center + np.array([-right - up, right - up, right + up, up - right])


@st.composite
def captures(draw: st.DrawFn) -> Capture:
    """Any pairing; devices on the lattice or a little beside it; windows that hold all, part or none of the light."""
    devices = [
        np.array(draw(points)) + draw(st.sampled_from([0.0, 0.1])) * np.array([0.3, -0.7, 0.64]) for _ in range(2)
    ]
    laser_at, sensor_at = devices[0], devices[draw(st.integers(0, 1))]
    pairing = draw(st.sampled_from(["exhaustive", "confocal"]))
    lasers = draw(st.integers(1, 3))
    count = lasers if pairing == "confocal" else draw(st.integers(1, 3))
    targets = np.array([draw(points) for _ in range(lasers)], float)
    targets[(targets == laser_at).all(axis=1)] += 0.25
    corners = np.stack([draw(pixels()) for _ in range(count)])
    bins = draw(st.sampled_from([1, 2, 17, 64, 400]))
    width_m = draw(st.sampled_from([3e-4, 0.01, 0.25, 1.0, 40.0]))
    start_m = draw(st.sampled_from([-3.0, 0.0, 0.0, 2.0, 6.5, 1000.0]))
    axis = TimeAxis(bins, width_m / C, start_m / C, draw(st.sampled_from(["source", "wall"])))
    radius = draw(st.sampled_from([1e-6, 0.02, 0.3]))
    sensor = Sensor(sensor_at, corners, radius, finite_aperture=draw(st.booleans()))
    return Capture(Laser(laser_at, targets), sensor, axis, pairing)


@st.composite
def accuracies(draw: st.DrawFn, *, counts: bool = False) -> Accuracy:
    """Numbers of samples and effects; or, unless only `counts` are wanted, a target that must choose them itself."""
    if not counts and draw(st.integers(0, 5)) == 0:
        return Accuracy(
            target=draw(st.sampled_from([1.0, 0.3, 0.05])), max_bounces=draw(st.sampled_from([3, 4, 5, None])),
            direct=draw(st.booleans()), secondary=draw(st.booleans()),
        )  # fmt: skip
    return Accuracy(
        samples=draw(st.sampled_from([1, 2, 5, 64, 256])), max_bounces=draw(st.sampled_from([3, 4, 4, 5, 8, None])),
        direct=draw(st.booleans()), secondary=draw(st.booleans()),
    )  # fmt: skip


@st.composite
def cases(draw: st.DrawFn, *, counts: bool = False) -> Case:
    return Case(draw(scenes()), draw(captures()), draw(accuracies(counts=counts)), draw(seeds))


def resized(case: Case, exponent: int) -> Case:
    """The same scene 2^exponent times as large, seen with the same aperture: every rounding stays as it was."""
    s, capture = 2.0**exponent, case.capture
    axis, sensor = capture.time, capture.sensor
    return replace(
        case,
        scene=replace(
            case.scene, vertices=case.scene.vertices * s, attenuation_per_m=case.scene.attenuation_per_m / s
        ),
        capture=Capture(
            Laser(capture.laser.position * s, capture.laser.targets * s),
            Sensor(sensor.position * s, sensor.pixels * s, sensor.aperture_radius_m),
            TimeAxis(axis.bins, axis.width_s * s, axis.start_s * s, axis.origin),
            capture.pairing,
        ),
    )


def rewindowed(case: Case, bins: int, start_s: float) -> Case:
    """The same with bins of the same width, but more or fewer of them, from another start."""
    capture = case.capture
    axis = replace(capture.time, bins=bins, start_s=start_s)
    return replace(case, capture=replace(capture, time=axis))
