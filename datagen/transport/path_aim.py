"""Densities with which paths of light (`paths.py`) draw first hidden vertices by area, which change only the noise.

A part is chosen first: small parts get more points for their area, as rays seldom meet them, and parts that no laser
point can light get none. Among the triangles of a part points are shared by a guess of the light for each pair of
laser point and pixel, as few triangles of a glossy mesh are bright, and near ones outshine others. The guess is the
integrand at the middle of the triangle, with lobes widened to the angle that the triangle and the pixel span.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from datagen.compiled import compiled
from datagen.records import Scene
from datagen.records.arrays import Bools, Floats, Ints
from datagen.transport.brdf import dot, evaluate, widen
from datagen.transport.geometry import TINY, distance, get, subtract
from datagen.transport.rays import Raycaster

GUESSES_PER_SAMPLE = 8
"""Guesses made for each sample at most, which then take as long as the rest of it. Points are drawn evenly over
meshes with more triangles."""


class Aim(NamedTuple):
    """How points are drawn by area for n pairs of laser point and pixel.

    Two lists hold numbers of the triangles of all parts. Those of part k for pair r begin at `begin[k]` + r
    `stride[k]`, where the stride of a part without guesses is 0.

    Attributes
    ----------
    running, chance : (K,) running sum of the chances of parts, and each chance over the part's area, 1/m².
    begin, stride, length : (K,) see above; the latter is the number of triangles.
    triangles, first : (F,) triangles sorted by part, and (K,) where those of a part begin.
    rank : (F,) place of each triangle within its part.
    density, share : the two lists: the density of points on a triangle, 1/m², and the running sum of the chances.
    """

    running: Floats
    chance: Floats
    begin: Ints
    stride: Ints
    length: Ints
    triangles: Ints
    first: Ints
    rank: Ints
    density: Floats
    share: Floats


def aim_of(caster: Raycaster, scene: Scene, planes: Floats, guesses: int) -> Aim:
    """The aim of pairs before they are known; `aim_at_pairs` adds their guesses.

    planes : (L, 6) positions and normals of laser points. guesses : most triangles that get guesses for each pair.
    """
    parts = len(scene.part_names)
    area = np.bincount(scene.face_part, caster.face_area_m2, parts)
    count = np.bincount(scene.face_part, minlength=parts)
    drawn = _may_be_lit(caster, scene, planes) & (area > 0)
    drawn = drawn if drawn.any() else area > 0
    chance = np.where(drawn, 1.0 / np.sqrt(np.where(drawn, area, 1.0)), 0.0)
    chance /= chance.sum()
    # Guesses go to the parts with the fewest triangles.
    order = np.argsort(np.where(drawn, count, 0), kind="stable")
    guessed = np.zeros(parts, np.bool_)
    guessed[order] = np.cumsum(np.where(drawn, count, 0)[order]) <= guesses
    # Parts without guesses come first in the lists.
    guessed &= drawn
    begin, stride = np.zeros(parts, np.int64), np.where(guessed, count[guessed].sum(), 0)
    at = 0
    for k in np.argsort(guessed, kind="stable"):
        begin[k], at = at, at + count[k]
    triangles, first = np.argsort(scene.face_part, kind="stable"), np.cumsum(count) - count
    rank = np.empty(len(triangles), np.int64)
    rank[triangles] = np.arange(len(triangles)) - np.repeat(first, count)
    density = np.empty(len(triangles))
    per_area = np.divide(chance, area, out=np.zeros(parts), where=area > 0)
    of = begin[scene.face_part] + rank
    density[of] = per_area[scene.face_part]
    share = np.empty(len(triangles))
    for k in range(parts):
        own = triangles[first[k] : first[k] + count[k]]
        share[begin[k] : begin[k] + count[k]] = np.cumsum(caster.face_area_m2[own]) / max(area[k], TINY)
    return Aim(np.cumsum(chance), per_area, begin, stride, count, triangles, first, rank, density, share)


def aim_at_pairs(aim: Aim, setup, x, v, size: Floats, area: Floats, radius: Floats) -> Aim:  # type: ignore[no-untyped-def]
    """The aim with guesses for n pairs of laser point x and point v that the middle of the pixel sees.

    setup, x, v : see `path_steps.py`; rows without power are points that do not exist. size : (n,) half the width of
    the patch that the pixel sees, m. area, radius : (F,) of triangles, m², m; the latter from middle to corner.
    """
    wide = int(aim.stride.max(initial=0))
    if not wide:
        return aim
    even = len(aim.density) - wide
    density, share = (np.concatenate([of[:even], np.tile(of[even:], len(size))]) for of in (aim.density, aim.share))
    _share_by_guesses(aim, setup, x, v, size, area, radius, density, share)
    return aim._replace(density=density, share=share)


def _may_be_lit(caster: Raycaster, scene: Scene, planes: Floats) -> Bools:
    """(K,) whether a part may be lit: a corner of its bounding box lies before the tangent plane of a laser point."""
    boxes = np.zeros((len(scene.part_names), 2, 3))
    for part in range(len(boxes)):
        corners = caster.corners[scene.face_part == part].reshape(-1, 3)
        if len(corners):
            boxes[part] = (corners.min(axis=0), corners.max(axis=0))
    highest = ((boxes[:, None] - planes[:, None, :3]) * planes[:, None, 3:]).max(axis=2).sum(axis=2)
    return np.asarray((highest > caster.offset_m).any(axis=1))


@compiled()
def draw_triangle(aim, row, number):  # type: ignore[no-untyped-def]
    """A triangle drawn for the pair of a row by a number in 0 … 1."""
    k = min(np.searchsorted(aim.running, number * aim.running[-1], side="right"), len(aim.running) - 1)
    below = aim.running[k - 1] if k > 0 else 0.0
    start, count = aim.begin[k] + row * aim.stride[k], aim.length[k]
    within = (number * aim.running[-1] - below) / (aim.running[k] - below)
    share = aim.share[start : start + count]
    return aim.triangles[aim.first[k] + min(np.searchsorted(share, within * share[-1], side="right"), count - 1)]


@compiled(inline="always")
def _guess(lit_from, seen_from, triangle, size, wide):  # type: ignore[no-untyped-def]
    """f₁ cosθ₁ |cosθ₂| / R₁² · f₂ · |cosθ₂′| cosθ₃ / R₃² · f₃ by way of the middle of a triangle, seen or not.

    lit_from, seen_from : laser point and FoV point: kind and row of the material, position, normal, direction to the
    device. triangle : kind and row, middle, normal, radius. size : half the width of the patch that the pixel sees.
    wide : a row to work in.
    """
    (kind1, row1, x, n, back_x), (kind3, row3, v, m, back_v) = lit_from, seen_from
    kind2, row2, middle, normal, radius = triangle
    d1, d3, r1, r3 = subtract(x, middle), subtract(v, middle), distance(x, middle), distance(v, middle)
    up1, up3 = dot(normal, d1), dot(normal, d3)
    # Surfaces transmit nothing: laser point and FoV point must lie on one side.
    if up1 * up3 <= 0.0:
        return 0.0
    if up1 < 0.0:
        normal = (-normal[0], -normal[1], -normal[2])
    w1, w3 = (d1[0] / r1, d1[1] / r1, d1[2] / r1), (d3[0] / r3, d3[1] / r3, d3[2] / r3)
    # A narrow lobe may miss the middle and still be bright elsewhere on the triangle. So it is widened by the angle
    # by which mirror direction and direction to the pixel vary over triangle and patch. A loop, as `wide[:] = …`
    # would also compile the error message for arrays that do not fit.
    for j in range(len(wide)):
        wide[j] = row2[j]
    widen(kind2, wide, radius / r1 + (radius + size) / r3)
    back_1, back_3 = (-w1[0], -w1[1], -w1[2]), (-w3[0], -w3[1], -w3[2])
    f = evaluate(kind2, wide, normal, w1, w3)
    f *= evaluate(kind1, row1, n, back_x, back_1) * evaluate(kind3, row3, m, back_3, back_v)
    cosines = max(-dot(n, w1), 0.0) * max(-dot(m, w3), 0.0) * abs(up1 * up3) / (r1 * r3)
    # A triangle counts as no nearer than its own size: rays by the BRDF find the light of nearer places.
    near = max(r1, radius) * max(r3, radius)
    return f * cosines / (near * near)


@compiled()
def _share_by_guesses(aim, setup, x, v, size, area, radius, density, share):  # type: ignore[no-untyped-def]
    """Write densities and running sums of the parts that have guesses, for each pair."""
    corners, normals, kind, values = setup.corners, setup.face_normal, setup.scene.kind, setup.scene.values
    wide = np.empty(values.shape[1])
    for r in range(len(size)):
        if not (x.power[r] > 0.0 and v.power[r] > 0.0):
            continue
        p1, p3 = setup.part[x.face[r]], setup.part[v.face[r]]
        lit_from = kind[p1], values[p1], get(x.position, r, 0), get(x.normal, r, 0), get(x.back, r, 0)
        seen_from = kind[p3], values[p3], get(v.position, r, 0), get(v.normal, r, 0), get(v.back, r, 0)
        for k in range(len(aim.length)):
            if aim.stride[k] == 0:
                continue
            start, count, first = aim.begin[k] + r * aim.stride[k], aim.length[k], aim.first[k]
            total = whole = 0.0
            for j in range(count):
                f = aim.triangles[first + j]
                middle = (
                    (corners[f, 0, 0] + corners[f, 1, 0] + corners[f, 2, 0]) / 3.0,
                    (corners[f, 0, 1] + corners[f, 1, 1] + corners[f, 2, 1]) / 3.0,
                    (corners[f, 0, 2] + corners[f, 1, 2] + corners[f, 2, 2]) / 3.0,
                )
                triangle = kind[k], values[k], middle, get(normals, f, 0), radius[f]
                light = _guess(lit_from, seen_from, triangle, size[r], wide)
                density[start + j] = light
                total, whole = total + light * area[f], whole + area[f]
            running = 0.0
            for j in range(count):
                # By the far tail of a lobe light may be too little to divide by. A quarter of the points are drawn
                # evenly: where a guess is far too low, a point weighs at most four times as much as without guesses.
                guessed = density[start + j] * whole / total if total > whole * 1e-300 else 1.0
                density[start + j] = aim.chance[k] * (0.25 + 0.75 * guessed)
                running += density[start + j] * area[aim.triangles[first + j]]
                share[start + j] = running
