"""Every way to light against the definition: energies, z-scores, errors claimed and found, on small scenes.

    python tests/benchmarks/ways.py                  # the cases that `tests/equivalence/test_all_ways.py` holds
    python tests/benchmarks/ways.py ggx flood        # those whose names have one of these words

Each case is a wall, a floor and a shape of one material. Its light comes from runs with different seeds of the
definition (`transport/reference.py`, up to four bounces), of plain paths, and of what a target chooses (the column
`way` names its sampler). Paths are compared with the definition, and what a target chooses with paths, which are far
less noisy. The numbers that are compared are energies: of a component, also in windows of time; of the whole in each
histogram, and outside the time axis; of a part's primary. z is the difference of a number beyond its slack, by the
t of Welch, given as a normal deviate; the table has the largest. `found` is the true error of a run to the target by
`datagen/bench/plain_check.py`, and `claimed` the error that the run states, in the root mean square of the runs.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
import trimesh
from every_brdf import BROAD
from numpy.typing import NDArray
from rooms import bins_of_path, rectangle, square_pixels
from scipy import stats

from datagen import Accuracy, Capture, Lambertian, Laser, Part, Scene, Sensor, simulate
from datagen.bench.measuring import machine, markdown, percent
from datagen.bench.plain_check import Checked, PlainPaths
from datagen.errors import InputWarning
from datagen.records import Transient
from datagen.records.arrays import l2_norm
from datagen.transport.reference import pairs_of, reference

Numbers = NDArray[np.float64]
DEFINITION, PATHS, TARGET = "definition", "paths", "target"
RUNS = {DEFINITION: 16, PATHS: 24, TARGET: 8}
"""Independent runs of each."""
SAMPLES = 1 << 14
"""Of a run of the definition or of paths, over all pairs of laser point and pixel."""
BOUNCES = {DEFINITION: 4, PATHS: 5, TARGET: 5}
"""Uniform vertices meet so little of the light of five bounces that their spread does not tell how much they miss."""
ASKED = 0.1
SLACK, RARE = 3e-3, 5e-4
"""What a number may be off by: of the energy of its component, as much as we promise for energies of the whole (it
covers what boxes in time carry into another window); and of all light, as paths may be so rare and so bright that no
run has one."""
KNOWN = 0.1
"""Standard error of the truth up to which a number is compared, relative to it."""
WINDOWS = 6

DEVICE = (0.6, -1.1, 2.0)
TIME = bins_of_path(66, 0.1, 0.0)


def turned(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    mesh.apply_transform(trimesh.transformations.rotation_matrix(0.6, (0.3, 1, 0.5)))
    mesh.apply_translation((0.9, 0.1, 1.0))
    return mesh


def plate() -> list[trimesh.Trimesh]:
    return [turned(rectangle((0, 0, 0), (0.05, 0.3, 0), (0, 0, 0.35)))]


def box() -> list[trimesh.Trimesh]:
    return [turned(trimesh.creation.box((0.4, 0.5, 0.3)))]


def ball() -> list[trimesh.Trimesh]:
    """1280 triangles."""
    return [turned(trimesh.creation.icosphere(subdivisions=3, radius=0.25))]


def sheet() -> list[trimesh.Trimesh]:
    """Half of a torus, which is seen from both sides."""
    mesh = trimesh.creation.torus(0.3, 0.12, major_sections=16, minor_sections=10)
    mesh.update_faces(mesh.triangles_center[:, 2] < 0.03)
    mesh.apply_transform(trimesh.transformations.rotation_matrix(-1.3, (0, 1, 0)))
    return [turned(mesh)]


def touching() -> list[trimesh.Trimesh]:
    """A plate whose edges lie on the wall and on the floor."""
    return [rectangle((0.3, 0.15, 0.3), (0.3, 0.1, 0), (0, 0, 0.3))]


def stack() -> list[trimesh.Trimesh]:
    """Two boxes with a common face, the lower one on the floor."""
    lower, upper = trimesh.creation.box((0.4, 0.4, 0.6)), trimesh.creation.box((0.3, 0.4, 0.4))
    lower.apply_translation((1.0, 0.1, 0.3))
    upper.apply_translation((1.0, 0.1, 0.8))
    return [lower, upper]


def coincident() -> list[trimesh.Trimesh]:
    """Two plates in one place: either may have the light, so that only their sum is compared."""
    return plate() + plate()


SHAPES: dict[str, Callable[[], list[trimesh.Trimesh]]] = {
    make.__name__: make for make in (box, ball, sheet, touching, stack, coincident, plate)
}


def confocal() -> Capture:
    points = np.array([[0, y, z] for y in (-0.5, 0.4) for z in (0.6, 1.3)])
    return Capture(Laser(DEVICE, points), Sensor(DEVICE, square_pixels(points, 0.005)), TIME, "confocal")


def exhaustive() -> Capture:
    lasers, seen = [[0, -0.5, 0.7], [0, 0.6, 1.2]], [[0, 0.2, 0.5], [0, -0.3, 1.3]]
    return Capture(Laser(DEVICE, lasers), Sensor(DEVICE, square_pixels(seen, 0.02)), TIME)


def array() -> Capture:
    sensor = Sensor.grid(DEVICE, (0, 0.1, 1.0), (0, 0.4, 0), (0, 0, 0.4), rows=3, columns=3)
    return Capture(Laser(DEVICE, [[0, -0.5, 0.9]]), sensor, TIME)


def flood() -> Capture:
    lasers, seen = [[0, y, 0.9] for y in (-0.4, 0.0, 0.4)], [[0, 0.3, 0.6], [0, -0.2, 1.3]]
    laser = Laser(DEVICE, lasers, weights=[1.0, 2.0, 3.0])
    return Capture(laser, Sensor(DEVICE, square_pixels(seen, 0.1)), TIME, illumination="flood")


def edges() -> Capture:
    """A pixel on the outline of most shapes and what is behind; and one on the crease of wall and floor."""
    return Capture(
        Laser(DEVICE, [[0, -0.5, 0.9]]), Sensor(DEVICE, square_pixels([[0.9, 0.3, 1.1], [0, 0.7, 0.0]], 0.1)), TIME
    )


def near() -> Capture:
    """A pixel of 20 cm beside the shape, which then stands close to the wall (`scene_of`)."""
    return Capture(
        Laser(DEVICE, [[0, -0.6, 1.2], [0, 0.2, 1.8]]), Sensor(DEVICE, square_pixels([[0, -0.3, 0.8]], 0.1)), TIME
    )


def ends_early() -> Capture:
    return replace(exhaustive(), time=bins_of_path(18, 0.1, 0.0))


def starts_late() -> Capture:
    return replace(confocal(), time=bins_of_path(40, 0.05, 1.6))


def from_source() -> Capture:
    """The legs of the device count, and an aperture so large that its disc is no point."""
    sensor = replace(exhaustive().sensor, aperture_radius_m=0.3, finite_aperture=True)
    return replace(exhaustive(), sensor=sensor, time=bins_of_path(66, 0.1, 2.0, "source"))


def fog() -> Capture:
    """A capture in fog (`scene_of`)."""
    return exhaustive()


def footprints() -> Capture:
    """Pixels of uneven sensitivity."""
    shares = np.array([[[0.0, 1.0, 2.0], [3.0, 0.5, 1.0]], [[1.0, 0.0, 0.0], [2.0, 4.0, 0.0]]])
    sensor = Sensor(DEVICE, square_pixels([[0, 0.2, 0.7], [0, -0.3, 1.3]], 0.15), footprints=shares)
    return Capture(Laser(DEVICE, [[0, 0.3, 0.75]]), sensor, TIME)


CAPTURES: dict[str, Callable[[], Capture]] = {
    make.__name__: make
    for make in (
        confocal, exhaustive, array, flood, edges, near, ends_early, starts_late, from_source, fog, footprints,
    )
}  # fmt: skip


def scene_of(material: str, shape: str, capture: str = "") -> Scene:
    """A wall, a floor, and a shape of one material."""
    wall = Part("wall", rectangle((0, 0, 1.1), (0, 1.2, 0), (0, 0, 1.1)), Lambertian(0.8), "relay_wall")
    floor = Part("floor", rectangle((0.9, 0, 0), (0.9, 0, 0), (0, 1.2, 0)), Lambertian(0.5), "structure")
    meshes = SHAPES[shape]()
    if capture == "near":
        gap = min(mesh.bounds[0, 0] for mesh in meshes)
        for mesh in meshes:
            mesh.apply_translation((min(0.02 - gap, 0.0), 0, 0))
    pieces = [Part(f"piece {k}", mesh, BROAD[material]) for k, mesh in enumerate(meshes)]
    return replace(Scene.from_parts([wall, floor, *pieces]), attenuation_per_m=0.4 * (capture == "fog"))


class Case(NamedTuple):
    """A scene and a capture, by name."""

    material: str
    shape: str
    capture: str


CHOSEN = (
    Case("lambertian 0.2", "touching", "near"), Case("lambertian 0.6", "stack", "array"),
    Case("lambertian 1", "box", "edges"), Case("oren-nayar 0.2", "plate", "footprints"),
    Case("oren-nayar 0.5", "ball", "from_source"), Case("oren-nayar 1.2", "touching", "exhaustive"),
    Case("phong 2", "ball", "confocal"), Case("phong 10", "sheet", "confocal"), Case("phong 60", "ball", "confocal"),
    Case("ggx 1", "sheet", "fog"), Case("ggx 0.6", "sheet", "array"), Case("ggx 0.4", "coincident", "near"),
    Case("retroreflector 0.4", "plate", "ends_early"), Case("retroreflector 0.2", "touching", "ends_early"),
    Case("retroreflector 0.12", "stack", "confocal"), Case("sin lobe x", "sheet", "flood"),
    Case("sin lobe z", "box", "flood"), Case("sin lobe xyz", "ball", "starts_late"),
)  # fmt: skip
"""Four are cases in which some way once lost light, or had too much."""
OTHERS = [name for name in BROAD if name not in {case.material for case in CHOSEN}]
CASES = [
    *CHOSEN,
    *(Case(name, list(SHAPES)[k % len(SHAPES)], list(CAPTURES)[k % len(CAPTURES)]) for k, name in enumerate(OTHERS)),
]
"""Each material once: a new one has a case without being named here."""


class Row(NamedTuple):
    """Light by one way, compared with another.

    light : component, "whole", or the name of a part. ratio, noise : of its energy to the other's, and standard
    error; NaN where there is no light. z : by name the z of the numbers that are known. claimed, found : relative L2
    error of a run, where one is claimed.
    """

    case: Case
    light: str
    way: str
    against: str
    ratio: float
    noise: float
    z: dict[str, float]
    claimed: float | None = None
    found: Checked | None = None

    def cells(self) -> list[str]:
        """The row of the table."""
        worst = max(self.z, key=lambda name: self.z[name], default="none known")
        z = f"{self.z[worst]:.1f} ({worst})" if self.z else worst
        energy = f"{self.ratio:.3f} ± {self.noise:.3f}" if np.isfinite(self.ratio) else "no light"
        errors = ["", ""] if self.claimed is None else [percent(self.claimed), str(self.found)]
        return [", ".join(self.case), self.light, f"{self.way} / {self.against}", energy, z, *errors]


def runs_of(case: Case) -> dict[str, list[Transient]]:
    """The runs of the definition, of plain paths, and to the target."""
    scene, capture = scene_of(*case), CAPTURES[case.capture]()
    samples = SAMPLES // len(pairs_of(capture))

    def run(way: str, seed: int) -> Transient:
        most = BOUNCES[way]
        if way == DEFINITION:
            return reference(scene, capture, samples=samples, replicates=1, max_bounces=most, seed=seed)
        effort = Accuracy(samples=samples, max_bounces=most) if way == PATHS else Accuracy(ASKED, max_bounces=most)
        return simulate(scene, capture, effort, seed)

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".*lie in one place", InputWarning)
        return {way: [run(way, seed) for seed in range(count)] for way, count in RUNS.items()}


def light_of(run: Transient, light: str) -> NDArray[np.float64]:
    """(histograms, bins) light of a component, of the whole, or of a part."""
    of = run.total if light == "whole" else run.parts[light] if light in run.parts else run.components[light]
    return of.reshape(-1, of.shape[-1])


def energies(run: Transient, light: str) -> dict[str, float]:
    """Energies of a component by window of time; of the whole by histogram, and outside the time axis; of a part."""
    of = light_of(run, light)
    if light in run.parts:
        return {"all": of.sum()}
    if light == "whole":
        return {f"histogram {k}": each for k, each in enumerate(of.sum(axis=1))} | {"outside": run.overflow.sum()}
    windows = np.array_split(of.sum(axis=0), WINDOWS)
    return {f"window {k}": each.sum() for k, each in enumerate(windows)} | {"all": of.sum()}


def z_scores(ours: Numbers, truth: Numbers, slack: Numbers) -> Numbers:
    """(n,) normal deviates as unlikely as the differences of two means of runs (R, n) beyond a slack; 0 within it."""
    off = np.maximum(np.abs(ours.mean(axis=0) - truth.mean(axis=0)) - slack, 0.0)
    a, b = (of.var(axis=0, ddof=1) / len(of) for of in (ours, truth))
    with np.errstate(invalid="ignore", divide="ignore"):
        freedom = (a + b) ** 2 / (a**2 / (len(ours) - 1) + b**2 / (len(truth) - 1))
        t = np.where(off > 0, off / np.sqrt(a + b), 0.0)
    return np.where(off > 0, -stats.norm.ppf(stats.t.sf(t, np.nan_to_num(freedom, nan=1.0))), 0.0)


def row_of(case: Case, light: str, ours: list[Transient], truth: list[Transient], way: str, against: str) -> Row:
    """One light of one way against another's."""
    names = list(energies(truth[0], light))
    a, b = (np.array([list(energies(run, light).values()) for run in runs]) for runs in (ours, truth))
    component = "primary" if light in truth[0].parts else light
    energy, whole = (np.mean([light_of(run, of).sum() for run in truth]) for of in (component, "whole"))
    z = z_scores(a, b, SLACK * energy + RARE * whole)
    known = stats.sem(b) <= KNOWN * b.mean(axis=0)
    ratio = noise = np.nan
    if b.any():
        found, true = (np.array([light_of(run, light).sum() for run in runs]) for runs in (ours, truth))
        ratio = float(found.mean() / true.mean())
        noise = float(np.hypot(stats.sem(found), ratio * stats.sem(true)) / true.mean())
    return Row(case, light, way, against, ratio, noise, {names[k]: float(z[k]) for k in np.flatnonzero(known)})


@cache
def compared(case: Case) -> list[Row]:
    """All lights of a case: paths against the definition, and what a target chooses against paths."""
    runs = runs_of(case)
    definition, paths, asked = runs[DEFINITION], runs[PATHS], runs[TARGET]
    parts = [] if case.shape == "coincident" else [name for name in paths[0].parts if name != "wall"]
    rows = [
        row_of(case, light, paths, definition, PATHS, DEFINITION) for light in [*definition[0].components, *parts]
    ]
    lights = [*paths[0].components, *parts, "whole"]
    each = {light: np.stack([light_of(run, light) for run in paths]) for light in lights}
    truth = PlainPaths(each, np.arange(each["whole"].shape[1]))
    for light in lights:
        way = TARGET if light == "whole" else asked[0].samplers.get(light, asked[0].samplers["primary"])
        row = row_of(case, light, asked, paths, way, PATHS)
        claims = [run.relative_error if light == "whole" else run.part_errors.get(light) for run in asked]
        if None not in claims:
            checks = [truth.check(light_of(run, light), light) for run in asked]
            # All runs are judged by the same truth, so that its noise does not fall by taking their mean.
            square, noise = (float(np.mean(of)) for of in zip(*((c.square, c.noise) for c in checks), strict=True))
            row = row._replace(claimed=l2_norm(np.array(claims)) / len(claims) ** 0.5, found=Checked(square, noise))
        rows.append(row)
    return rows


def pooled(rows: list[Row]) -> dict[tuple[str, str, str], tuple[float, float]]:
    """(light, way, against) → mean ratio of energies over cases that are known, and its standard error."""
    found: dict[tuple[str, str, str], list[Row]] = {}
    for row in rows:
        if row.noise <= KNOWN and not row.light.startswith(("piece", "floor")):
            found.setdefault((row.light, row.way, row.against), []).append(row)
    means = {}
    for key, of in found.items():
        # Not by 1/noise² alone: runs that miss light are also those that look least noisy.
        weights = 1 / np.array([row.noise**2 + SLACK**2 for row in of])
        noise = float(np.sqrt(np.sum((weights * [row.noise for row in of]) ** 2)) / weights.sum())
        means[key] = float(np.average([row.ratio for row in of], weights=weights)), noise
    return means


def main() -> None:
    """The table."""
    words, rows = sys.argv[1:], []
    print(f"{machine()}; target {percent(ASKED)}, up to {BOUNCES[TARGET]} bounces\n")
    print(markdown(["case", "light", "way / truth", "energy", "largest z", "claimed", "found"], [], words=3))
    for case in CASES:
        if not words or any(word in ", ".join(case) for word in words):
            rows += compared(case)
            for row in compared(case):
                print(f"| {' | '.join(row.cells())} |", flush=True)
    print()
    for (light, way, against), (mean, noise) in pooled(rows).items():
        print(f"energy of {light} by {way} over {against}, all cases: {mean:.4f} ± {noise:.4f}")


if __name__ == "__main__":
    main()
