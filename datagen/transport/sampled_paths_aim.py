"""Where `sampled_paths.py` looks for hidden vertices by area: a matter of its variance, never of its mean.

Small parts get more points for their area, as rays seldom meet them, and parts that no laser point can light get
none. Within a part its triangles get points by a guess, for each pair of laser point and pixel: the integrand at
the middle of each, with a lobe as wide as what the triangle and the pixel span: a glossy mesh is bright on few.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from datagen.compiled import compiled
from datagen.records import Scene
from datagen.records.arrays import Bools, Floats, Ints
from datagen.transport.brdf import GGX_LOBE, PHONG, RETROREFLECTOR, MaterialTable, dot, evaluate
from datagen.transport.visibility.raycast import Raycaster

EVENLY = 0.25
"""Share of the points of a part that are drawn evenly over its area all the same: where a guess is wrong, they count
at most four times what they would without guesses."""
GUESSES_PER_SAMPLE = 16
"""Guesses for each sample up to which they are made: as many take about half the time of a sample. Where meshes have
more triangles, points are drawn evenly over them."""


class Ends(NamedTuple):
    """The laser points, or what the middles of the pixels see, of n pairs; a part of −1 where there is none.

    position, normal, back : (n, 3), `back` towards laser or sensor. part : (n,). size : (n,) half the width, metres.
    """

    position: Floats
    normal: Floats
    back: Floats
    part: Ints
    size: Floats


@dataclass(frozen=True)
class Aim:
    """How points are drawn by area for n pairs: on each part as often for all of them, and within the parts for whose
    G triangles there are guesses by those of each pair. The other triangles have none, and no row for each pair.

    Attributes
    ----------
    density : (F,) 1/m², of a point on each triangle, where there is no guess.
    guessed : (n, G) 1/m², where there is one.
    column : (F,) that of a triangle in `guessed`, −1 for those without a guess.
    faces, others : (G,) triangles with a guess; those without.
    share : of all points, those that fall on triangles with a guess.
    cumulative : (n · G,) running share of these in each row, one more in each row; and of the others.
    """

    density: Floats
    guessed: Floats
    column: Ints
    faces: Ints
    others: Ints
    share: float
    cumulative: tuple[Floats, Floats]

    @classmethod
    def of(cls, density: Floats, area: Floats, faces: Ints, guessed: Floats) -> Aim:
        """From densities on all triangles (F,), their areas, and densities (n, G) on those `faces` with a guess."""
        column = np.full(len(area), -1)
        column[faces] = np.arange(len(faces))
        others = np.flatnonzero(column < 0)
        share = float(density[faces] @ area[faces])
        of_guessed, of_others = np.cumsum(guessed * area[faces], axis=1), np.cumsum(density[others] * area[others])
        of_guessed /= of_guessed[:, -1:] if len(faces) else 1.0
        rows = of_guessed + np.arange(len(guessed))[:, None]
        share = share / (share + of_others[-1]) if len(others) else 1.0
        running = of_others / (of_others[-1] or 1.0) if len(others) else of_others
        return cls(density, guessed, column, faces, others, share, (rows.ravel(), running))

    def drawn(self, pair: Ints, number: Floats) -> Ints:
        """(m,) a triangle for each pair and number in 0 … 1."""
        found, first = np.empty(len(number), np.int64), (number < self.share) | (len(self.others) == 0)
        rows, running = self.cumulative
        # Kept off its ends, where rounding would fall into a neighbouring row.
        within = np.clip(number[first] / (self.share or 1.0), 1e-12, 1 - 1e-12)
        at = np.searchsorted(rows, pair[first] + within, side="right") - pair[first] * len(self.faces)
        found[first] = self.faces[np.clip(at, 0, len(self.faces) - 1)]
        beyond = (number[~first] - self.share) / max(1.0 - self.share, 1e-300)
        at = np.searchsorted(running, np.clip(beyond, 1e-12, 1 - 1e-12), side="right")
        found[~first] = self.others[np.minimum(at, len(self.others) - 1)]
        return found

    def at(self, pair: Ints, face: Ints) -> Floats:
        """(m,) the density, 1/m², of points of some pairs on some triangles."""
        column, density = self.column[face], self.density[face]
        known = column >= 0
        density[known] = self.guessed[pair[known], column[known]]
        return density


def aim(
    caster: Raycaster, scene: Scene, materials: MaterialTable, planes: Floats, x: Ends, v: Ends, samples: int
) -> Aim:
    """For pairs of ends x, v and so many samples in all. planes : (L, 6) positions and normals of laser points."""
    area = np.bincount(scene.face_part, caster.face_area_m2, len(scene.part_names))
    drawn = _lit(caster, scene, planes) & (area > 0)
    drawn = drawn if drawn.any() else area > 0
    chance = np.where(drawn, 1.0 / np.sqrt(np.where(drawn, area, 1.0)), 0.0)
    per_area = chance / chance.sum() / np.where(drawn, area, 1.0)
    has_guess = _guessed(scene, drawn, GUESSES_PER_SAMPLE * samples // max(len(x.part), 1))
    faces = np.flatnonzero(has_guess[scene.face_part])
    middle = caster.corners[faces].mean(axis=1)
    radius = np.linalg.norm(caster.corners[faces] - middle[:, None], axis=2).max(axis=1)
    part = scene.face_part[faces].astype(np.int64)
    guess = _guesses(materials.kind, materials.values, part, caster.face_normal[faces], middle, radius, x, v)
    for own in np.flatnonzero(has_guess):
        of = np.flatnonzero(part == own)
        found = guess[:, of] @ caster.face_area_m2[faces[of]]
        share = guess[:, of] * np.divide(area[own], found, out=np.zeros_like(found), where=found > 0)[:, None]
        evenly = np.where(found > 0, EVENLY, 1.0)[:, None]
        guess[:, of] = per_area[own] * (evenly + (1 - EVENLY) * share)
    return Aim.of(per_area[scene.face_part], caster.face_area_m2, faces, guess)


def _guessed(scene: Scene, drawn: Bools, most: int) -> Bools:
    """(K,) parts for whose triangles guesses are made: of those drawn the ones with the fewest, up to so many."""
    count = np.bincount(scene.face_part, minlength=len(drawn))
    order = np.argsort(np.where(drawn, count, 0), kind="stable")
    guessed = np.zeros(len(drawn), np.bool_)
    guessed[order] = np.cumsum(np.where(drawn, count, 0)[order]) <= most
    return guessed & drawn


def _lit(caster: Raycaster, scene: Scene, planes: Floats) -> Bools:
    """(K,) parts of which a corner of the box about them lies before the tangent plane of a laser point."""
    boxes = np.empty((len(scene.part_names), 2, 3))
    for part in range(len(boxes)):
        corners = caster.corners[scene.face_part == part].reshape(-1, 3)
        boxes[part] = (corners.min(axis=0), corners.max(axis=0)) if len(corners) else 0.0
    highest = ((boxes[:, None] - planes[:, None, :3]) * planes[:, None, 3:]).max(axis=2).sum(axis=2)
    return np.asarray((highest > caster.offset_m).any(axis=1))


@compiled()
def _guesses(kind, values, part, normal, middle, radius, x, v):  # type: ignore[no-untyped-def]
    """(n, F) f₁ cosθ₁ |cosθ₂| / R₁² · f₂ · |cosθ₂′| cosθ₃ / R₃² · f₃ at the middles of F triangles, for n pairs."""
    out = np.zeros((len(x.part), len(part)))
    row = np.empty(values.shape[1])
    for p in range(len(x.part)):
        if x.part[p] < 0 or v.part[p] < 0:
            continue
        n1, n3 = (x.normal[p, 0], x.normal[p, 1], x.normal[p, 2]), (v.normal[p, 0], v.normal[p, 1], v.normal[p, 2])
        back1, back3 = (x.back[p, 0], x.back[p, 1], x.back[p, 2]), (v.back[p, 0], v.back[p, 1], v.back[p, 2])
        for i in range(len(part)):
            d1 = (x.position[p, 0] - middle[i, 0], x.position[p, 1] - middle[i, 1], x.position[p, 2] - middle[i, 2])
            d3 = (v.position[p, 0] - middle[i, 0], v.position[p, 1] - middle[i, 1], v.position[p, 2] - middle[i, 2])
            n = (normal[i, 0], normal[i, 1], normal[i, 2])
            up1, up3 = dot(n, d1), dot(n, d3)
            if up1 * up3 <= 0.0:
                continue
            if up1 < 0.0:
                n = (-n[0], -n[1], -n[2])
            r1, r3 = math.sqrt(dot(d1, d1)), math.sqrt(dot(d3, d3))
            w1, w3 = (d1[0] / r1, d1[1] / r1, d1[2] / r1), (d3[0] / r3, d3[1] / r3, d3[2] / r3)
            # The angle by which the mirror direction and that to the pixel differ from one end to the other.
            span = radius[i] / r1 + (radius[i] + v.size[p]) / r3
            k = kind[part[i]]
            # In a loop: the message for arrays that do not fit would be compiled with `row[:] = …`, text and all.
            for j in range(len(row)):
                row[j] = values[part[i], j]
            if k in (PHONG, RETROREFLECTOR):
                row[1] = min(row[1], 1.0 / (span * span))
            elif k == GGX_LOBE:
                row[1] = min(max(row[1], 0.5 * span), 1.0)
            f1 = evaluate(kind[x.part[p]], values[x.part[p]], n1, back1, (-w1[0], -w1[1], -w1[2]))
            f3 = evaluate(kind[v.part[p]], values[v.part[p]], n3, (-w3[0], -w3[1], -w3[2]), back3)
            f2 = evaluate(k, row, n, w1, w3)
            cosines = max(-dot(n1, w1), 0.0) * max(-dot(n3, w3), 0.0) * abs(up1 * up3) / (r1 * r3)
            # Not nearer than its own size: the rest comes by rays.
            near1, near3 = max(r1, radius[i]), max(r3, radius[i])
            out[p, i] = f1 * f2 * f3 * cosines / (near1 * near1 * near3 * near3)
    return out
