"""A tree of boxes over triangles, by the surface area heuristic in bins (Wald, "On fast construction of SAH-based
bounding volume hierarchies", IEEE Symposium on Interactive Ray Tracing 2007)."""

from __future__ import annotations

import numpy as np

from datagen.compiled import compiled

LEAF, BINS = 3, 12
"""Triangles up to which a box is not divided; places along its longest side where it may be."""


@compiled()
def boxes_over(low, high):  # type: ignore[no-untyped-def]
    """Order of F triangles, whose own boxes are given, and the boxes over them.

    low, high : (F, 3) lowest and highest corner of each triangle.

    Returns order : (F,), and box, children and span as `Hierarchy` has them.
    """
    count = len(low)
    most = max(2 * count, 1)
    order, spare = np.arange(count), np.empty(count, np.int64)
    box, link = np.empty((most, 6)), np.zeros((most, 3), np.int64)
    link[0, 2], n, k = count, 1, 0
    members, bounds, cost = np.empty(BINS, np.int64), np.empty((BINS, 6)), np.empty(BINS)
    while k < n:
        link[k, 0], first, last = -1, link[k, 1], link[k, 2]
        axis, smallest, largest = 0, 0.0, -1.0
        for j in range(3):
            box[k, j], box[k, 3 + j], least, greatest = np.inf, -np.inf, np.inf, -np.inf
            for f in order[first:last]:
                box[k, j], box[k, 3 + j] = min(box[k, j], low[f, j]), max(box[k, 3 + j], high[f, j])
                least, greatest = min(least, low[f, j] + high[f, j]), max(greatest, low[f, j] + high[f, j])
            if greatest - least > largest:
                axis, smallest, largest = j, least, greatest - least
        if last - first > LEAF:
            members[:] = 0
            for m in range(BINS):
                for j in range(3):
                    bounds[m, j], bounds[m, 3 + j] = np.inf, -np.inf
            for f in order[first:last]:
                m = _bin(low, high, f, axis, smallest, largest)
                members[m] += 1
                for j in range(3):
                    bounds[m, j] = min(bounds[m, j], low[f, j])
                    bounds[m, 3 + j] = max(bounds[m, 3 + j], high[f, j])
            cost[:] = 0.0
            for step in (1, -1):
                _swept(members, bounds, cost, step)
            best = 1
            for m in range(2, BINS):
                if cost[m] < cost[best]:
                    best = m
            middle, rest = first, 0
            for f in order[first:last]:
                if _bin(low, high, f, axis, smallest, largest) < best:
                    order[middle] = f
                    middle += 1
                else:
                    spare[rest] = f
                    rest += 1
            for m in range(rest):
                order[middle + m] = spare[m]
            if middle in (first, last):
                middle = (first + last) // 2
            link[k, 0] = n
            link[n, 1], link[n, 2], link[n + 1, 1], link[n + 1, 2] = first, middle, middle, last
            n += 2
        k += 1
    second = np.where(link[:n, 0] < 0, -1, link[:n, 0] + 1)
    return order, box[:n], np.column_stack((link[:n, 0], second)), link[:n, 1:]


@compiled()
def _bin(low, high, f, axis, smallest, largest):  # type: ignore[no-untyped-def]
    if largest <= 0.0:
        return 0
    return min(int((low[f, axis] + high[f, axis] - smallest) / largest * BINS), BINS - 1)


@compiled()
def _swept(members, bounds, cost, step):  # type: ignore[no-untyped-def]
    """Add to each cut between bins what the bins on one side of it cost: how many triangles, in how large a box."""
    total = 0
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for turn in range(BINS):
        m = turn if step > 0 else BINS - 1 - turn
        cut = m if step > 0 else m + 1
        side = high - low
        if 0 < cut < BINS and total > 0:
            cost[cut] += total * (side[0] * side[1] + side[1] * side[2] + side[2] * side[0])
        elif 0 < cut < BINS:
            cost[cut] += np.inf
        total += members[m]
        for j in range(3):
            low[j], high[j] = min(low[j], bounds[m, j]), max(high[j], bounds[m, 3 + j])
