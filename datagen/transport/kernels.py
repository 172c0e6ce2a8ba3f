"""The compiled loops behind `connections.py`: plain arrays in, plain arrays out.

Argument names: a trailing 2 means at the lookin, 3 at the FoV point; `rows`, `positions`, `energies` say for each
contribution the histogram row, the fractional bin and the energy.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from datagen.transport.binning import splat
from datagen.transport.brdf import LAMBERTIAN, evaluate, pdf


@njit(cache=True, inline="always")
def _is_near(position, kind, center, reach):
    """Whether a lookin could overfill a footprint of a pixel; a lobe narrower than Lambert's always could."""
    if kind != LAMBERTIAN or reach == np.inf:
        return True
    x, y, z = position[0] - center[0], position[1] - center[1], position[2] - center[2]
    return x * x + y * y + z * z < reach * reach


@njit(cache=True)
def near_a_pixel(laser, position, part, kind, center, reach, first_laser, confocal):
    """Indices of the lookins that are near any of their pixels."""
    kept = np.empty(len(laser), np.int64)
    n = 0
    for i in range(len(laser)):
        local = laser[i] - first_laser
        for p in range(local if confocal else 0, local + 1 if confocal else len(reach)):
            if _is_near(position[i], kind[part[i]], center[p], reach[p]):
                kept[n] = i
                n += 1
                break
    return kept[:n]


@njit(cache=True)
def gather(
    start, stop, laser, position2, normal2, to_laser, part2, power, path, block, position3, normal3, to_sensor,
    part3, weight3, footprint3, leg3, patch_center,
    patch_reach, kind, values, points_per_lookin, first_laser, confocal, pixels, split_of_part,
    splits, per_metre, clock_start, center, half_extent, offset, origins, spans, rows, positions, energies,
):  # fmt: skip
    found = 0
    for i in range(start, stop):
        local = laser[i] - first_laser
        first_pixel = local if confocal else 0
        last_pixel = local + 1 if confocal else pixels
        n2x, n2y, n2z = normal2[i, 0], normal2[i, 1], normal2[i, 2]
        x2, y2, z2 = position2[i, 0], position2[i, 1], position2[i, 2]
        cos_in = n2x * to_laser[i, 0] + n2y * to_laser[i, 1] + n2z * to_laser[i, 2]
        ox = np.float32((x2 + offset * n2x - center[0]) / half_extent)
        oy = np.float32((y2 + offset * n2y - center[1]) / half_extent)
        oz = np.float32((z2 + offset * n2z - center[2]) / half_extent)
        material2 = values[part2[i]]
        kind2 = kind[part2[i]]
        for p in range(first_pixel, last_pixel):
            near = _is_near(position2[i], kind2, patch_center[p], patch_reach[p])
            row = (local if confocal else local * pixels + p) * splits + split_of_part[part2[i]]
            for q in range(block[i] * points_per_lookin, (block[i] + 1) * points_per_lookin):
                if weight3[p, q] == 0.0:
                    continue
                dx, dy, dz = position3[p, q, 0] - x2, position3[p, q, 1] - y2, position3[p, q, 2] - z2
                square = dx * dx + dy * dy + dz * dz
                if square == 0.0:
                    continue
                distance = math.sqrt(square)
                cos2 = (dx * n2x + dy * n2y + dz * n2z) / distance
                cos3 = -(dx * normal3[p, q, 0] + dy * normal3[p, q, 1] + dz * normal3[p, q, 2]) / distance
                if cos2 <= 0.0 or cos3 <= 0.0:
                    continue
                cos_sensor = (
                    to_sensor[p, q, 0] * normal3[p, q, 0]
                    + to_sensor[p, q, 1] * normal3[p, q, 1]
                    + to_sensor[p, q, 2] * normal3[p, q, 2]
                )
                f2 = evaluate(kind2, material2, cos_in, cos2)
                f3 = evaluate(kind[part3[p, q]], values[part3[p, q]], cos3, cos_sensor)
                followed = pdf(kind2, material2, cos2) * cos3 * footprint3[p, q] if near else 0.0
                energy = power[i] * f2 * f3 * cos2 * cos3 * weight3[p, q] / (square + followed)
                if energy <= 0.0:
                    continue
                tx = np.float32((position3[p, q, 0] + offset * normal3[p, q, 0] - center[0]) / half_extent)
                ty = np.float32((position3[p, q, 1] + offset * normal3[p, q, 1] - center[1]) / half_extent)
                tz = np.float32((position3[p, q, 2] + offset * normal3[p, q, 2] - center[2]) / half_extent)
                origins[found, 0], origins[found, 1], origins[found, 2] = ox, oy, oz
                spans[found, 0], spans[found, 1], spans[found, 2] = tx - ox, ty - oy, tz - oz
                rows[found] = row
                positions[found] = (path[i] + distance + leg3[p, q]) * per_metre - clock_start
                energies[found] = energy
                found += 1
    return found


@njit(cache=True)
def deposit(rows, positions, energies, hidden, histogram, overflow):
    for k in range(len(rows)):
        if not hidden[k]:
            overflow[rows[k]] += splat(histogram[rows[k]], positions[k], energies[k])


@njit(cache=True)
def inside_pixels(
    position3, normal3, part3, direction, laser, position2, normal2, to_laser, part2, power, path, kind, values,
    sensor, planes, solid_angle, patch_center, patch_reach,
    aperture_area, points_per_lookin, first_laser, confocal, pixels, split_of_part,
    splits, per_metre, clock_start, count_last_leg,
):  # fmt: skip
    owners, rows = [np.int64(0)], [np.int64(0)]
    positions, energies = [0.0], [0.0]
    for i in range(len(laser)):
        if part3[i] < 0:
            continue
        wx, wy, wz = position3[i, 0] - sensor[0], position3[i, 1] - sensor[1], position3[i, 2] - sensor[2]
        reach = math.sqrt(wx * wx + wy * wy + wz * wz)
        cos_sensor = -(wx * normal3[i, 0] + wy * normal3[i, 1] + wz * normal3[i, 2]) / reach
        if cos_sensor <= 0.0:
            continue
        local = laser[i] - first_laser
        for p in range(local if confocal else 0, local + 1 if confocal else pixels):
            inside = True
            for k in range(4):
                if wx * planes[p, k, 0] + wy * planes[p, k, 1] + wz * planes[p, k, 2] < 0.0:
                    inside = False
                    break
            if not (inside and _is_near(position2[i], kind[part2[i]], patch_center[p], patch_reach[p])):
                continue
            dx, dy, dz = (
                position3[i, 0] - position2[i, 0],
                position3[i, 1] - position2[i, 1],
                position3[i, 2] - position2[i, 2],
            )
            square = dx * dx + dy * dy + dz * dz
            distance = math.sqrt(square)
            cos_in = normal2[i, 0] * to_laser[i, 0] + normal2[i, 1] * to_laser[i, 1] + normal2[i, 2] * to_laser[i, 2]
            cos2 = direction[i, 0] * normal2[i, 0] + direction[i, 1] * normal2[i, 1] + direction[i, 2] * normal2[i, 2]
            cos3 = -(
                direction[i, 0] * normal3[i, 0] + direction[i, 1] * normal3[i, 1] + direction[i, 2] * normal3[i, 2]
            )
            if cos2 <= 0.0 or cos3 <= 0.0:
                continue
            material2, kind2 = values[part2[i]], kind[part2[i]]
            density = pdf(kind2, material2, cos2)
            footprint = solid_angle[p] * reach * reach / (cos_sensor * points_per_lookin)
            followed = density * cos3 * footprint
            f2 = evaluate(kind2, material2, cos_in, cos2)
            f3 = evaluate(kind[part3[i]], values[part3[i]], cos3, cos_sensor)
            energy = (
                power[i] * f2 * cos2 / density * (followed / (square + followed))
                * f3 * aperture_area * cos_sensor / (reach * reach)
            )  # fmt: skip
            if energy <= 0.0:
                continue
            owners.append(np.int64(i))
            rows.append((local if confocal else local * pixels + p) * splits + split_of_part[part2[i]])
            leg = reach if count_last_leg else 0.0
            positions.append((path[i] + distance + leg) * per_metre - clock_start)
            energies.append(energy)
    return np.array(owners[1:]), np.array(rows[1:]), np.array(positions[1:]), np.array(energies[1:])
