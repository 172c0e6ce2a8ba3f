"""Densities with which `sampled_paths.py` draws first hidden vertices by area, which change only its variance.

Small parts get more points for their area, as rays seldom meet them. Parts that no laser point can light get none.
Among the triangles of a part points are shared by a guess of the light for each pair of laser point and pixel, as few
triangles of a glossy mesh are bright. The guess is the integrand at the middle of the triangle, with lobes widened to
the angle that the triangle and the pixel span.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from datagen.compiled import compiled
from datagen.records import Scene
from datagen.records.arrays import Bools, Floats, Ints
from datagen.transport.brdf import MaterialTable, dot, evaluate, widen
from datagen.transport.visibility.raycast import Raycaster

EVENLY = 0.25
"""Share of a part's points that are drawn evenly over its area in spite of the guesses. Where a guess is far too low,
a point then weighs four times as much as without guesses at most; with half of it, eight times."""
GUESSES_PER_SAMPLE = 16
"""Guesses made for each sample at most; they take about half the time of the sample. Points are drawn evenly over
meshes with more triangles; with half as many, over meshes half as fine already, which adds noise where they gloss."""


class Ends(NamedTuple):
    """The laser points of n pairs, or the points that the middles of their pixels see.

    position, normal, back : (n, 3) metres; unit normal; unit direction to the laser or sensor. part : (n,) index, −1
    where there is no point. size : (n,) half the width of the patch that the pixel sees, m.
    """

    position: Floats
    normal: Floats
    back: Floats
    part: Ints
    size: Floats


@dataclass(frozen=True)
class Aim:
    """The densities with which points are drawn by area for n pairs of laser point and pixel.

    All pairs draw points on a part equally often. G of the F triangles have a guess for each pair, which shares a
    part's points among them; on all others the density is the same for every pair.

    Attributes
    ----------
    density : (F,) density of points on each triangle without a guess, 1/m².
    guessed : (n, G) density of points of each pair on each triangle with a guess, 1/m².
    column : (F,) column of each triangle in `guessed`, −1 for a triangle without a guess.
    faces, others : (G,) indices of the triangles with a guess; (F − G,) of those without.
    share : share of all points that fall on triangles with a guess.
    cumulative : (n · G,) running shares of the triangles with a guess, those of pair k in k … k + 1, so that one
        search serves all pairs; (F − G,) running shares of the triangles without a guess.
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
        """The record from `density` (F,) and `area` (F,) of all triangles, and `guessed` (n, G) of `faces` (G,)."""
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
        """(m,) indices of triangles, drawn for each pair (m,) by a number (m,) in 0 … 1."""
        found, first = np.empty(len(number), np.int64), (number < self.share) | (len(self.others) == 0)
        rows, running = self.cumulative
        # Kept off the ends of 0 … 1, where rounding would lead into the row of the neighbouring pair.
        within = np.clip(number[first] / (self.share or 1.0), 1e-12, 1 - 1e-12)
        at = np.searchsorted(rows, pair[first] + within, side="right") - pair[first] * len(self.faces)
        found[first] = self.faces[np.clip(at, 0, len(self.faces) - 1)]
        beyond = (number[~first] - self.share) / max(1.0 - self.share, 1e-300)
        at = np.searchsorted(running, np.clip(beyond, 1e-12, 1 - 1e-12), side="right")
        found[~first] = self.others[np.minimum(at, len(self.others) - 1)]
        return found

    def at(self, pair: Ints, face: Ints) -> Floats:
        """(m,) densities, 1/m², with which pairs (m,) draw points on triangles (m,)."""
        column, density = self.column[face], self.density[face]
        known = column >= 0
        density[known] = self.guessed[pair[known], column[known]]
        return density


def aim(
    caster: Raycaster, scene: Scene, materials: MaterialTable, planes: Floats, x: Ends, v: Ends, samples: int
) -> Aim:
    """The densities for n pairs of laser point x and pixel v.

    planes : (L, 6) positions and normals of the laser points. samples : total number, which limits the guesses.
    """
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
        # By the far tail of a lobe light may be too little to divide by.
        lit = found > area[own] * np.finfo(np.float64).tiny
        share = guess[:, of] * np.divide(area[own], found, out=np.zeros_like(found), where=lit)[:, None]
        evenly = np.where(lit, EVENLY, 1.0)[:, None]
        guess[:, of] = per_area[own] * (evenly + (1 - EVENLY) * share)
    return Aim.of(per_area[scene.face_part], caster.face_area_m2, faces, guess)


def _guessed(scene: Scene, drawn: Bools, most: int) -> Bools:
    """(K,) whether the triangles of a part get guesses: of the parts in `drawn` (K,) those with the fewest triangles,
    as long as these are `most` in all."""
    count = np.bincount(scene.face_part, minlength=len(drawn))
    order = np.argsort(np.where(drawn, count, 0), kind="stable")
    guessed = np.zeros(len(drawn), np.bool_)
    guessed[order] = np.cumsum(np.where(drawn, count, 0)[order]) <= most
    return guessed & drawn


def _lit(caster: Raycaster, scene: Scene, planes: Floats) -> Bools:
    """(K,) whether a part may be lit: a corner of its bounding box lies before the tangent plane of a laser point."""
    boxes = np.empty((len(scene.part_names), 2, 3))
    for part in range(len(boxes)):
        corners = caster.corners[scene.face_part == part].reshape(-1, 3)
        boxes[part] = (corners.min(axis=0), corners.max(axis=0)) if len(corners) else 0.0
    highest = ((boxes[:, None] - planes[:, None, :3]) * planes[:, None, 3:]).max(axis=2).sum(axis=2)
    return np.asarray((highest > caster.offset_m).any(axis=1))


@compiled()
def _guesses(kind, values, part, normal, middle, radius, x, v):  # type: ignore[no-untyped-def]
    """(n, F) guesses f₁ cosθ₁ |cosθ₂| / R₁² · f₂ · |cosθ₂′| cosθ₃ / R₃² · f₃ for n pairs on F triangles.

    The light of a triangle is that of its middle.
    radius : (F,) distance from a triangle's middle to its farthest corner, m. Visibility is not checked.
    """
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
            # Surfaces transmit nothing: laser point and FoV point must lie on one side.
            if up1 * up3 <= 0.0:
                continue
            if up1 < 0.0:
                n = (-n[0], -n[1], -n[2])
            r1, r3 = math.sqrt(dot(d1, d1)), math.sqrt(dot(d3, d3))
            w1, w3 = (d1[0] / r1, d1[1] / r1, d1[2] / r1), (d3[0] / r3, d3[1] / r3, d3[2] / r3)
            # The angle by which mirror direction and direction to the pixel vary over triangle and patch. A lobe is
            # widened to it, as a narrow lobe may miss the middle and still be bright elsewhere on the triangle.
            span = radius[i] / r1 + (radius[i] + v.size[p]) / r3
            k = kind[part[i]]
            # A loop, as `row[:] = …` would also compile the error message for arrays that do not fit.
            for j in range(len(row)):
                row[j] = values[part[i], j]
            widen(k, row, span)
            f1 = evaluate(kind[x.part[p]], values[x.part[p]], n1, back1, (-w1[0], -w1[1], -w1[2]))
            f3 = evaluate(kind[v.part[p]], values[v.part[p]], n3, (-w3[0], -w3[1], -w3[2]), back3)
            f2 = evaluate(k, row, n, w1, w3)
            cosines = max(-dot(n1, w1), 0.0) * max(-dot(n3, w3), 0.0) * abs(up1 * up3) / (r1 * r3)
            # A triangle counts as no nearer than its own size: rays by the BRDF find the light of nearer places.
            near1, near3 = max(r1, radius[i]), max(r3, radius[i])
            out[p, i] = f1 * f2 * f3 * cosines / (near1 * near1 * near3 * near3)
    return out
