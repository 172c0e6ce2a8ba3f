"""The paper's estimator as its Eq. 6 and Eq. 8 print it, beside `radiometric.py`.

Scholes & Leach, "Path Tracing-Inspired Modeling of Non-Line-of-Sight SPAD Data", Sensors 24(20), 6522 (2024). It
reproduces that paper's figures and shows what its weights do; for data use `simulate`.
"""

from __future__ import annotations

import time as clock_time
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from datagen.compiled import compiled
from datagen.errors import InputError
from datagen.paper.convolution import Paths, double_sum, keep_strongest
from datagen.paper.printed_paths import Grid, Lighting, PrintedRoom, arriving, half_cube, leaving, lighting, ray_grid
from datagen.records import Capture, Scene, Transient
from datagen.records.arrays import Floats, Ints
from datagen.records.checks import check_choice, check_integer, check_kind, check_number

Secondary = Literal["all", "strongest", "none"]
Conserved = Literal["room", "lookin", "rays"]

POINTS_AT_ONCE = 1 << 18
"""Observed points in memory at once."""
MAX_RAYS, MAX_PIXELS = 1024, 1024


@dataclass(frozen=True)
class AsPrinted:
    """Sample counts of the paper's estimator, and choices that its text leaves open.

    Attributes
    ----------
    rays : n of the n × n grid of rays from each laser point, N = n²; 1 … 1024 (the paper: 10 and 45).
    pixels : side of each lookin's unfolded picture, a multiple of 4 up to 1024 (the paper: 60); of its pixels² places
        3/4 are directions (`half_cube`).
    unit_m : the unit of length of every 1/R² and of the aperture, metres; Eq. 6 and 8 depend on it. The authors'
        notebook works in millimetres.
    secondary : `"all"` paths of Eq. 8; `"strongest"`: only the strongest arriving path of each lookin, by amplitude
        (sec. 4, the optimised scheme); `"none"`.
    grid : how the rays fill the hemisphere, `"angles"` or `"solid_angle"` (`ray_grid`).
    conserved : the set over which α₁B₁ of Eq. 8 sums to one: `"room"`, all lit observed points of all lookins, which
        conserves energy as the text demands of α₁; `"lookin"`, those of each lookin, the set that k runs over;
        `"rays"`: the α₁ of Eq. 6, one symbol, one constant.
    """

    rays: int = 10
    pixels: int = 60
    unit_m: float = 1e-3
    secondary: Secondary = "all"
    grid: Grid = "angles"
    conserved: Conserved = "room"

    @property
    def lookins(self) -> int:
        """N, rays from each laser point."""
        return self.rays**2

    @property
    def observed(self) -> int:
        """Ñ, directions of each lookin's camera: the paper's 60 × 60 without the empty corners."""
        return 3 * self.pixels**2 // 4

    def __post_init__(self) -> None:
        check_integer("AsPrinted", "rays", self.rays, 1, MAX_RAYS)
        check_integer("AsPrinted", "pixels", self.pixels, 1, MAX_PIXELS)
        if self.pixels % 4:
            raise InputError(
                f"AsPrinted.pixels = {self.pixels}: must be a multiple of 4, for half faces of pixels/2 × pixels/4"
            )
        check_number("AsPrinted", "unit_m", self.unit_m, 1e-9, 1e9, "a length in metres, such as 1e-3")
        for name, kind in (("secondary", Secondary), ("grid", Grid), ("conserved", Conserved)):
            check_choice(f"AsPrinted.{name}", getattr(self, name), get_args(kind))


def simulate_as_printed(scene: Scene, capture: Capture, settings: AsPrinted | None = None) -> Transient:
    """The likelihood of Eq. 6 and Eq. 8, as printed, before quantum efficiency and impulse response.

    For lookins j from a grid of rays, the observed points k that the half cube of pixels at each sees, and those of
    them within the sensor's field of view, n; u the unit of length, C the transmission of 1 m of air:

        A₁ = Γ₁ C^R α₁B₁ (u/R)²       R = R_j,  laser point → j             Eq. 6
        A₂ = Γⱼ C^R αⱼBⱼ (u/R)²       R = R_n,  j → n                       Eq. 6
        A₃ = Γₙ C^2R βₙBₙ (u/R)²      R = R_ns, n → sensor                  Eq. 6
        L_p = π (f/2f_no)²/u² · Σⱼ Σₙ A₁ A₂ A₃            at (R_j + R_n + R_ns)/c

        Â₁ = Γ₁ C^R α₁B₁ (u/R)²       R = R_k,  laser point → k, where lit  Eq. 8
        Â₂ = Γ_k C^R β_kB_k (u/R)²    R = R_kj, k → j                       Eq. 8
        L_s = π (f/2f_no)²/u² · Σⱼ Σ_k Σₙ Â₁ Â₂ A₂ A₃     at (R_k + R_kj + R_n + R_ns)/c, Eq. 7

    B is cosφ or |sinθ| of the leaving direction, whatever comes in; receiving surfaces have no cosine. Each α is
    1/Σ B over the directions sampled, all counted alike. β, "a modified normalization that accounts for the single
    input and output vectors", has no set of directions to sum over: taken here as 1/∫ B dω over the hemisphere, 1/π
    and 1/4. `AsPrinted` names the other choices. C^2R on the last leg includes the laser's way to the wall.

    The light of one emitted photon, I = 1, falls into the capture's bins by arrival time;
    convolved with the Gaussian of width σ and times q it is the paper's L(t). Every pair (k, n) is formed by itself:
    O(Ñ²) for each lookin.

    Parameters
    ----------
    scene, capture : as for `simulate`; parts Lambertian or SinLobe. The aperture counts as a small one.
    settings : default `AsPrinted()`: the paper's 10 × 10 × 60 × 60, in millimetres.

    Returns
    -------
    Transient with components `primary` and `secondary`, (L, P, T), and the primary by the lookin's part. The samples
    are a fixed grid, so `stderr` is NaN.

    Raises
    ------
    InputError : for a BRDF that the paper does not have, or a pixel that is no convex quadrilateral.
    """
    check_kind("scene", scene, Scene)
    check_kind("capture", capture, Capture)
    settings = AsPrinted() if settings is None else settings
    check_kind("settings", settings, AsPrinted)
    began = clock_time.perf_counter()
    room = PrintedRoom.of(scene, capture, settings.unit_m)
    lasers, pixels, bins = capture.shape
    aperture = capture.sensor.aperture_area_m2 / settings.unit_m**2
    parts = np.zeros((len(scene.part_names), lasers, pixels, bins))
    overflow = np.zeros((lasers, pixels))
    secondary = np.zeros((lasers, pixels, bins))
    seconds = {"prepare": clock_time.perf_counter() - began, "trace": 0.0, "secondary": 0.0}
    for laser in np.flatnonzero(room.points.part >= 0):
        place = parts[:, laser], secondary[laser], overflow[laser]
        _add_laser_point(room, settings, int(laser), *place, seconds)
        for light in place:
            light *= aperture
    components = {"primary": parts.sum(axis=0)}
    if settings.secondary != "none":
        components["secondary"] = secondary
    return Transient(
        time=capture.time,
        components=components,
        parts=dict(zip(scene.part_names, parts, strict=True)),
        stderr=np.full(capture.shape, np.nan),
        overflow=overflow,
        laser_points=room.points.position,
        seconds=seconds,
    )


def _add_laser_point(
    room: PrintedRoom, settings: AsPrinted, laser: int, parts: Floats, secondary: Floats, overflow: Floats,
    seconds: dict[str, float],
) -> None:  # fmt: skip
    """Add the light of one laser point, without the aperture, to parts (K, P, T), secondary (P, T), overflow (P,)."""
    capture = room.capture
    _, count, bins = capture.shape
    pixels = np.array([laser]) if capture.pairing == "confocal" else np.arange(count)
    before = room.points.leg[laser] if capture.time.origin == "source" else 0.0
    start = float(room.bins(np.array(before))) - capture.time.start_s / capture.time.width_s
    camera = half_cube(settings.pixels)
    lookins = room.lookins(laser, ray_grid(settings.rays, settings.grid))
    light, late = np.zeros((count, bins)), np.zeros(count)
    total = 0.0
    at_once = max(1, POINTS_AT_ONCE // (len(camera) * max(1, len(pixels) // 8)))
    for first in range(0, len(lookins), at_once):
        chunk = lookins.take(slice(first, first + at_once))
        began = clock_time.perf_counter()
        seen = room.observed(chunk, camera)
        out, _ = leaving(room, chunk, seen, pixels)
        _add_primary(chunk.amplitude, start + room.bins(chunk.distance), chunk.part, out, parts, overflow)
        traced = clock_time.perf_counter()
        seconds["trace"] += traced - began
        if settings.secondary == "none":
            continue
        lit = lighting(room, laser, seen)
        into = arriving(room, laser, chunk, seen, lit)
        if settings.conserved == "lookin":
            into = _each_lookin_alike(into, lit)
        if settings.secondary == "strongest":
            keep_strongest(into, 1)
        double_sum(_present(into), out._replace(position=out.position + start), light, late)
        total += float(lit.brdf.sum())
        seconds["secondary"] += clock_time.perf_counter() - traced
    alpha = {"room": 1.0 / total if total > 0 else 0.0, "lookin": 1.0, "rays": lookins.alpha}[settings.conserved]
    secondary += alpha * light
    overflow += alpha * late


def _each_lookin_alike(into: Paths, light: Lighting) -> Paths:
    """α₁ = 1 / Σ B₁ over the lit observed points of each lookin."""
    total = light.brdf.sum(axis=1)
    alpha = np.divide(1.0, total, out=np.zeros_like(total), where=total > 0)
    return into._replace(energy=into.energy * np.repeat(alpha, np.diff(into.first)))


def _present(paths: Paths) -> Paths:
    """The paths that carry energy."""
    kept = paths.energy > 0
    first = np.concatenate([[0], np.cumsum(kept)])[paths.first]
    return Paths(first, paths.position[kept], paths.energy[kept])


@compiled()
def _add_primary(
    amplitude: Floats, position: Floats, part: Ints, out: Paths, parts: Floats, overflow: Floats
) -> None:
    """Add A₁ · A₂A₃ for every lookin and each path out of it (Eq. 6)."""
    pixels, bins = parts.shape[1:]
    for row in range(len(out.first) - 1):
        # Paths are listed lookin by lookin, and for each of them pixel by pixel.
        lookin, pixel = row // pixels, row % pixels
        for n in range(out.first[row], out.first[row + 1]):
            arrival, energy = position[lookin] + out.position[n], amplitude[lookin] * out.energy[n]
            if 0.0 <= arrival < bins:
                parts[part[lookin], pixel, int(arrival)] += energy
            else:
                overflow[pixel] += energy
