"""Which vertices see the field of view with nothing in between, proven without a ray.

A connection needs no shadow ray where the hull of its vertex and a *tile* (a box about neighbouring pixels' FoV
points) is free of occluders. Proofs that hold for many are made once for a scene: the walls of its shell hide
nothing from the inside (`occluders.py`), and for each cell of a grid only those bodies are kept that meet the hull of
the cell and the whole field of view. A vertex in a cell with none left is done; in another it is held against the
few that are left, first for the whole field of view, then tile by tile. What is not proven is asked by a ray, so the
transient is the same to the order of summation.

Cells, tiles and whether it is worth while at all are fixed by counts of triangles and connections, never by a clock.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from datagen.records import Sensor
from datagen.records.arrays import Floats, Ints
from datagen.transport.fields_of_view import FovPool
from datagen.transport.visibility import clear_sight_kernels as kernels
from datagen.transport.visibility.clear_sight_kernels import Bodies, Grid, Tiles
from datagen.transport.visibility.lines_of_sight import lines_of_sight
from datagen.transport.visibility.occluders import occluders
from datagen.transport.visibility.raycast import Raycaster

CONNECTIONS_WORTH_PROVING = 1 << 16
"""Fewer are asked sooner than a grid is made."""
CONNECTIONS_PER_TRIANGLE = 32
"""Connections for each triangle from which it pays to look for the shell and to put boxes about the others."""
CONNECTIONS_PER_TEST = 4
"""Connections for each test of a cell against a body: a test takes about a third of a ray's time."""
CELLS_ALONG = (4, 12)
"""Cells along the scene's longest side, at least and at most."""
TILES_AT_MOST = 16
CONNECTIONS_PER_TILE = 16
GAP = 5e-6
"""Distance, in half extents of the scene, that separating planes must leave: some fifty roundings of a ray."""
OWN_GAP = 0.5
"""The same for a triangle's own plane, in units of the distance that ray ends are lifted off their surfaces."""
TESTS_PER_CONNECTION = 4
"""Bodies a vertex is held against, at most, for each of its connections."""
THOROUGH_FROM = 32
PROBES = 5
WORTH_TRYING_ON = 0.2
"""Share of connections proven, under which the rest of a simulation is asked."""

Occlusion = Literal["auto", "on", "off"]


@dataclass
class _State:
    """What has been found out, shared by all views of one `ClearSight`.

    Attributes
    ----------
    asked, proven, assumed : connections by how their visibility was found.
    expected : connections there will be, or 0 where nobody knows.
    worth_from : connections from which proofs are tried, None for never (again).
    """

    asked: int = 0
    proven: int = 0
    assumed: int = 0
    expected: int = 0
    worth_from: int | None = None
    proofs: _Proofs | None = None
    last: tuple[FovPool, NDArray[np.int8]] | None = None


@dataclass(frozen=True)
class ClearSight:
    """Proofs of clear sight for one scene and sensor.

    It remembers what it found out about cells; what it answers depends on the scene, the sensor and the counts alone.

    Attributes
    ----------
    each : connections of every vertex, over all of its pixels.
    pixels : those looked at, in the sensor's numbers; None for all.
    """

    occlusion: Occlusion
    caster: Raycaster | None = None
    sensor: Sensor | None = None
    each: int = 1
    pixels: Ints | None = None
    _state: _State = field(default_factory=_State)

    @classmethod
    def of(cls, caster: Raycaster, sensor: Sensor, occlusion: Occlusion, each: int, expected: int = 0) -> ClearSight:
        """expected : connections there will be, about; 0 where that turns out later."""
        least = max(CONNECTIONS_WORTH_PROVING, CONNECTIONS_PER_TRIANGLE * len(caster.corners))
        worth_from = least if occlusion == "auto" else None
        return cls(occlusion, caster, sensor, each, None, _State(expected=expected, worth_from=worth_from))

    @classmethod
    def asking(cls) -> ClearSight:
        """One that proves nothing, so that every connection is asked by a ray."""
        return cls("on")

    def take(self, pixels: Ints) -> ClearSight:
        """The same, with some of the pixels numbered anew."""
        return replace(self, pixels=pixels if self.pixels is None else self.pixels[pixels])

    def prepare(self, connections: int) -> None:
        """Say that so many connections come next. Proofs are made once as many as pay for them were asked, or are
        known to come: at worst that costs as much again as asking all."""
        state = self._state
        known = max(state.expected, state.asked + connections)
        if state.worth_from is None or state.proofs is not None or known < state.worth_from:
            return
        assert self.caster is not None and self.sensor is not None
        state.proofs = _Proofs.of(self.caster, self.sensor, known, self.each)
        if state.proofs is None:
            state.worth_from = 4 * known

    def tiles(self, pool: FovPool, pixels: Ints) -> NDArray[np.int8]:
        """(P, Q) the tile each FoV point of a pool lies in, −1 for none; `pixels` are those of the pool."""
        state = self._state
        if state.proofs is None:
            return np.zeros(pool.weight.shape, np.int8)
        if state.last is None or state.last[0] is not pool:
            own = pixels if self.pixels is None else self.pixels[pixels]
            state.last = pool, state.proofs.tiles_of(pool, own)
        return state.last[1]

    def clear(self, position: Floats, normal: Floats, pixel: Ints | None) -> NDArray[np.uint64]:
        """(n,) for each vertex a bit for each tile that it sees whole, for certain; or assumed, with occlusion off.

        position, normal : (n, 3) metres, unit normal. pixel : (n,) the one pixel a vertex is joined to; None for all.
        """
        if self.occlusion == "off":
            return np.full(len(position), ~np.uint64(0))
        if self._state.proofs is None:
            return np.zeros(len(position), np.uint64)
        if pixel is None:
            pixel = np.full(len(position), -1)
        elif self.pixels is not None:
            pixel = self.pixels[pixel]
        return self._state.proofs.clear(position, normal, pixel)

    def count(self, found: int, without_ray: int) -> None:
        """Take note of `found` connections, `without_ray` of which no ray was sent for."""
        state = self._state
        state.asked += found - without_ray
        if self.occlusion == "off":
            state.assumed += without_ray
            return
        state.proven += without_ray
        if state.proofs is not None and state.proofs.tried(found, without_ray) < WORTH_TRYING_ON:
            state.proofs, state.last, state.worth_from = None, None, None

    @property
    def rays(self) -> dict[str, int]:
        """Connections so far: "asked" by a ray, "proven" clear, "assumed" so."""
        return {"asked": self._state.asked, "proven": self._state.proven, "assumed": self._state.assumed}


@dataclass
class _Proofs:
    lift: float
    gap: float
    own_gap: float
    bodies: Bodies
    grid: Grid
    tiles: Tiles
    frames: Floats
    first: Ints
    count: Ints
    members: NDArray[np.int32]
    known: NDArray[np.uint64]
    tests: int
    found: int = 0
    proven: int = 0

    def tried(self, found: int, proven: int) -> float:
        """The share of connections proven so far, 1 while there were too few to tell."""
        self.found += found
        self.proven += proven
        return self.proven / self.found if self.found > CONNECTIONS_WORTH_PROVING else 1.0

    @classmethod
    def of(cls, caster: Raycaster, sensor: Sensor, connections: int, each: int) -> _Proofs | None:
        bodies = occluders(caster)
        # Surfaces fill about four layers of a cube's cells.
        affordable = connections / (CONNECTIONS_PER_TEST * 4 * max(1, len(bodies.corners)))
        along = min(int(affordable**0.5), CELLS_ALONG[1])
        if along < CELLS_ALONG[0]:
            return None
        # A vertex that is joined to one pixel of many needs only that pixel's tile.
        tiles_worth = TILES_AT_MOST if each < len(sensor.pixels) else each // CONNECTIONS_PER_TILE
        frames, of_pixel = _tiles(caster, sensor, max(1, min(TILES_AT_MOST, tiles_worth)))
        if not len(frames):
            return None
        low, high = caster.corners.min(axis=(0, 1)), caster.corners.max(axis=(0, 1))
        side = float((high - low).max()) / along
        shape = np.maximum(1, np.ceil((high - low) / side)).astype(np.int64)
        # The last box is about all others, its axes those of the first.
        whole = _bounds(np.concatenate([_corners(frame) for frame in frames]), frames[0, 1:4], 0.0)
        all_frames = np.array([*frames, whole])
        boxes = np.array([_corners(frame) for frame in all_frames])
        heights = np.einsum("tck,nk->tnc", boxes, bodies.normal) - bodies.level[None, :, None]
        heights = np.stack([heights.min(axis=2), heights.max(axis=2)], axis=2)
        normals = np.ascontiguousarray(all_frames[:, 3])
        tiles = Tiles(boxes, normals, boxes.min(axis=1), boxes.max(axis=1), heights, of_pixel)
        cells = int(shape.prod())
        return cls(
            caster.offset_m, GAP * caster.half_extent_m, OWN_GAP * caster.offset_m, bodies, Grid(low, side, shape),
            tiles, frames, np.full(cells, -1, np.int64), np.zeros(cells, np.int64), np.empty(0, np.int32),
            np.zeros(cells, np.uint64), TESTS_PER_CONNECTION * each,
        )  # fmt: skip

    def tiles_of(self, pool: FovPool, pixels: Ints) -> NDArray[np.int8]:
        return np.asarray(
            kernels.tiles_of_points(
                pool.position, pool.normal, pool.weight, pixels, self.tiles.of_pixel, self.frames, self.bodies.shell,
                self.lift, self.own_gap, 1e-3 * self.lift,
            )
        )  # fmt: skip

    def clear(self, position: Floats, normal: Floats, pixel: Ints) -> NDArray[np.uint64]:
        cells = kernels.cells_of(position, self.grid)
        unknown = cells[self.first[cells] < 0]
        if len(unknown):
            unknown = np.unique(unknown)
            # A vertex is counted to a cell with rounding, and its end of the ray is lifted.
            counts, members, known = kernels.bodies_in_view(
                unknown, self.grid, 2 * self.lift, self.tiles.corners, self.bodies, self.gap
            )
            self.known[unknown] = known
            self.first[unknown] = len(self.members) + np.cumsum(counts) - counts
            self.count[unknown] = counts
            self.members = np.concatenate([self.members, members])
        return np.asarray(
            kernels.prove(
                position, normal, pixel, cells, self.first, self.count, self.members, self.known, self.bodies,
                self.tiles, self.lift, self.gap, self.own_gap, self.tests, self.tests >= THOROUGH_FROM,
            )
        )  # fmt: skip


def _tiles(caster: Raycaster, sensor: Sensor, most: int) -> tuple[Floats, Ints]:
    """Boxes (T, 5, 3) about what groups of neighbouring pixels see, and the group (P,) of each pixel, −1 for none.

    A grid of lines of sight over each pixel, its corners included, finds where its FoV points lie; a point that a
    later line finds outside is asked by a ray. Where most of a group's points lie in one plane the others are left
    out, so that clutter on a wall does not spoil the view of the rest.
    """
    lines = lines_of_sight(caster, sensor, PROBES)
    valid, normal = lines.valid, lines.normal
    lifted = lines.position + caster.offset_m * normal
    of_pixel = np.full(len(valid), -1, np.int64)
    seeing = np.flatnonzero(valid.any(axis=1))
    if not len(seeing):
        return np.empty((0, 5, 3)), of_pixel
    middle = np.array([lifted[p][valid[p]].mean(axis=0) for p in seeing])
    frames = []
    for group in _halved(middle, most):
        pixels = seeing[group]
        points, normals = lifted[pixels][valid[pixels]], normal[pixels][valid[pixels]]
        frames.append(_box_about(points, normals, 1e-3 * caster.offset_m))
        of_pixel[pixels] = len(frames) - 1
    return np.array(frames), of_pixel


def _halved(points: Floats, most: int) -> list[Ints]:
    """Groups of neighbouring points (n, 3), halved across their longest side while there are fewer than `most`."""
    groups = [np.arange(len(points))]
    while 2 * len(groups) <= most and max(len(g) for g in groups) > 1:
        halves = []
        for group in groups:
            ranked = group[np.argsort(points[group, np.ptp(points[group], axis=0).argmax()], kind="stable")]
            halves += [ranked[: len(ranked) // 2], ranked[len(ranked) // 2 :]]
        groups = [half for half in halves if len(half)]
    return groups


def _box_about(points: Floats, normals: Floats, slack: float) -> Floats:
    """The box (corner, three axes, extents) about points (n, 3), its third axis along the plane most of them lie in,
    or along their mean normal where there is none."""
    height = np.einsum("nk,nk->n", points, normals)
    middle = np.argsort(height, kind="stable")[len(points) // 2]
    axis = normals[middle]
    flat = (np.abs((points - points[middle]) @ axis) <= slack) & (normals @ axis > 1 - 1e-12)
    if 2 * np.count_nonzero(flat) >= len(points):
        points = points[flat]
    else:
        mean = normals.sum(axis=0)
        length = np.linalg.norm(mean)
        axis = mean / length if length > 1e-6 * len(points) else axis
    across = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    across /= np.linalg.norm(across)
    return _bounds(points, np.stack([across, np.cross(axis, across), axis]), slack)


def _bounds(points: Floats, axes: Floats, slack: float) -> Floats:
    local = (points - points[0]) @ axes.T
    low, high = local.min(axis=0) - slack, local.max(axis=0) + slack
    return np.concatenate([(points[0] + low @ axes)[None], axes, (high - low)[None]])


def _corners(frame: Floats) -> Floats:
    """(8, 3): the front face (the far end of the third axis) in order, then the back face."""
    steps = np.array([[i, j, k] for k in (1, 0) for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))])
    return np.asarray(frame[0] + (steps * frame[4]) @ frame[1:4], np.float64)
