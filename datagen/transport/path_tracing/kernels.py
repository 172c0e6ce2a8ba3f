"""The compiled loops behind `vertices.py` and `connections.py`: plain arrays in, plain arrays out.

Argument names: a trailing 1 means at the laser point, 2 at a vertex, 3 at the FoV point; `rows`, `positions`,
`energies` say for each contribution the histogram row, the fractional bin and the energy.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from datagen.compiled import compiled
from datagen.records.arrays import Bools, Floats, Ints
from datagen.transport.binning import put
from datagen.transport.brdf import LAMBERTIAN, Vector, dot, evaluate, pdf, sample
from datagen.transport.sampling import mix

Kinds = NDArray[np.integer]
Contributions = tuple[Ints, Ints, Floats, Floats]
"""Vertex or laser point, histogram row, fractional bin and energy of each."""


@compiled(inline="always")
def _at(array: Floats, i: int) -> Vector:
    return (array[i, 0], array[i, 1], array[i, 2])


@compiled()
def scatter(
    kind: Kinds, values: Floats, part: Ints, normal: Floats, w_in: Floats, uv: Floats,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Directions (n, 3) drawn by each vertex's BRDF, and the throughput f cosθ / pdf (n,)."""
    directions, throughput = np.empty((len(part), 3)), np.empty(len(part))
    for i in range(len(part)):
        k, material, n, incoming = kind[part[i]], values[part[i]], _at(normal, i), _at(w_in, i)
        w = sample(k, material, n, incoming, uv[i, 0], uv[i, 1])
        directions[i, 0], directions[i, 1], directions[i, 2] = w
        density = pdf(k, material, n, incoming, w)
        f = evaluate(k, material, n, incoming, w)
        throughput[i] = f * dot(n, w) / density if f > 0.0 and density > 0.0 else 0.0
    return directions, throughput


@compiled()
def random_numbers(streams: NDArray[np.uint64], step: int, count: int) -> Floats:
    """(n, count) independent uniform numbers in the open interval 0 … 1, a function of (stream, step)."""
    out = np.empty((len(streams), count))
    for i in range(len(streams)):
        for k in range(count):
            word = mix(streams[i] + (np.uint64(step) << np.uint64(32)), np.uint64(k + 1))
            out[i, k] = (np.float64(word) + 0.5) * 2.0**-32
    return out


@compiled()
def light_lookins(
    face: NDArray[np.int32], position: Floats, owner: Ints, position1: Floats, normal1: Floats, to_laser1: Floats,
    part1: Ints, kind: Kinds, values: Floats, face_normal: Floats, by_area_too: Bools, rays: float,
    area_density: float,
) -> tuple[Ints, Floats, Floats, Floats, Floats]:  # fmt: skip
    """Which candidates are lit, their facing normal, direction and distance to the laser point, and their power."""
    kept = np.empty(len(face), np.int64)
    normal, to_laser_point = np.empty((len(face), 3)), np.empty((len(face), 3))
    distance, power = np.empty(len(face)), np.empty(len(face))
    n = 0
    for i in range(len(face)):
        f, o = face[i], owner[i]
        if f < 0:
            continue
        d = (position[i, 0] - position1[o, 0], position[i, 1] - position1[o, 1], position[i, 2] - position1[o, 2])
        square = dot(d, d)
        if square == 0.0:
            continue
        r = math.sqrt(square)
        w = (d[0] / r, d[1] / r, d[2] / r)
        n1, w_in, facing = _at(normal1, o), _at(to_laser1, o), _at(face_normal, f)
        cos2 = -dot(facing, w)
        cos1 = dot(n1, w)
        if cos1 <= 0.0 or cos2 == 0.0:
            continue
        side = 1.0 if cos2 > 0.0 else -1.0
        k1, material1 = kind[part1[o]], values[part1[o]]
        spread = abs(cos2) / square
        density = rays * pdf(k1, material1, n1, w_in, w) * spread
        if by_area_too[f]:
            density += area_density
        if density <= 0.0:
            continue
        energy = evaluate(k1, material1, n1, w_in, w) * cos1 * spread / density
        if not energy > 0.0:
            continue
        kept[n], distance[n], power[n] = i, r, energy
        for k in range(3):
            normal[n, k] = side * facing[k]
            to_laser_point[n, k] = -w[k]
        n += 1
    return kept[:n], normal[:n], to_laser_point[:n], distance[:n], power[:n]


@compiled(inline="always")
def _is_near(position: Vector, kind: int, center: Floats, reach: float) -> bool:
    """Whether a vertex could overfill a footprint of a pixel; a lobe narrower than Lambert's always could."""
    if kind != LAMBERTIAN or reach == np.inf:
        return True
    d = (position[0] - center[0], position[1] - center[1], position[2] - center[2])
    return dot(d, d) < reach * reach


@compiled()
def near_a_pixel(
    laser: Ints, position: Floats, part: Ints, kind: Kinds, center: Floats, reach: Floats, first_laser: int,
    confocal: bool,
) -> Ints:  # fmt: skip
    """Indices of the vertices that are near any of their pixels."""
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


@compiled()
def gather(
    start: int, stop: int, laser: Ints, position2: Floats, normal2: Floats, to_previous: Floats, part2: Ints,
    power: Floats, path: Floats, block: Ints, position3: Floats, normal3: Floats, to_sensor: Floats, part3: Ints,
    weight3: Floats, footprint3: Floats, last_leg: Floats, patch_center: Floats, patch_reach: Floats, kind: Kinds,
    values: Floats, points_per_vertex: int, attenuation: float, first_laser: int, confocal: bool, pixels: int,
    split_of_part: Ints, splits: int, per_metre: float, clock_start: float, device_leg: Floats, center: Floats,
    half_extent: float, offset: float, tile3: NDArray[np.int8], clear: NDArray[np.uint64], histogram: Floats,
    overflow: Floats, origins: NDArray[np.float32], spans: NDArray[np.float32], rows: Ints, positions: Floats,
    energies: Floats,
) -> tuple[int, int]:  # fmt: skip
    """Every connection of vertices start … stop that can carry energy: shadow ray, row, fractional bin, energy.

    Where the vertex is known to see the tile of the FoV point (`clear_sight.py`) the energy is added at once instead.
    `device_leg` (laser,) is the path from laser to laser point where device legs count for the time, else −1.
    Returns how many connections wait for their rays, and how many needed none.
    """
    found, added = 0, 0
    for i in range(start, stop):
        local = laser[i] - first_laser
        x2, n2, w_in = _at(position2, i), _at(normal2, i), _at(to_previous, i)
        k2, material2 = kind[part2[i]], values[part2[i]]
        ox = np.float32((x2[0] + offset * n2[0] - center[0]) / half_extent)
        oy = np.float32((x2[1] + offset * n2[1] - center[1]) / half_extent)
        oz = np.float32((x2[2] + offset * n2[2] - center[2]) / half_extent)
        for p in range(local if confocal else 0, local + 1 if confocal else pixels):
            near = _is_near(position2[i], k2, patch_center[p], patch_reach[p])
            row = (local if confocal else local * pixels + p) * splits + split_of_part[part2[i]]
            for q in range(block[i] * points_per_vertex, (block[i] + 1) * points_per_vertex):
                if weight3[p, q] == 0.0:
                    continue
                x3 = (position3[p, q, 0], position3[p, q, 1], position3[p, q, 2])
                d = (x3[0] - x2[0], x3[1] - x2[1], x3[2] - x2[2])
                square = dot(d, d)
                toward = dot(d, n2)
                if toward <= 0.0:
                    continue
                n3 = (normal3[p, q, 0], normal3[p, q, 1], normal3[p, q, 2])
                away = -dot(d, n3)
                if away <= 0.0 or square == 0.0:
                    continue
                distance = math.sqrt(square)
                inverse = 1.0 / distance
                w = (d[0] * inverse, d[1] * inverse, d[2] * inverse)
                back = (-w[0], -w[1], -w[2])
                cos2, cos3 = toward * inverse, away * inverse
                out = (to_sensor[p, q, 0], to_sensor[p, q, 1], to_sensor[p, q, 2])
                f2 = evaluate(k2, material2, n2, w_in, w)
                f3 = evaluate(kind[part3[p, q]], values[part3[p, q]], n3, back, out)
                followed = pdf(k2, material2, n2, w_in, w) * cos3 * footprint3[p, q] if near else 0.0
                energy = power[i] * f2 * f3 * cos2 * cos3 * weight3[p, q] / (square + followed)
                if attenuation > 0.0:
                    energy *= math.exp(-attenuation * (distance + last_leg[p, q]))
                if not energy > 0.0:
                    continue
                device = device_leg[local] + last_leg[p, q] if device_leg[local] >= 0.0 else 0.0
                at = (path[i] + distance + device) * per_metre - clock_start
                tile = tile3[p, q]
                if tile >= 0 and (clear[i - start] >> np.uint64(tile)) & np.uint64(1):
                    overflow[row] += put(histogram[row], at, energy)
                    added += 1
                    continue
                tx = np.float32((x3[0] + offset * n3[0] - center[0]) / half_extent)
                ty = np.float32((x3[1] + offset * n3[1] - center[1]) / half_extent)
                tz = np.float32((x3[2] + offset * n3[2] - center[2]) / half_extent)
                origins[found, 0], origins[found, 1], origins[found, 2] = ox, oy, oz
                spans[found, 0], spans[found, 1], spans[found, 2] = tx - ox, ty - oy, tz - oz
                rows[found], positions[found], energies[found] = row, at, energy
                found += 1
    return found, added


@compiled()
def deposit(
    rows: Ints, positions: Floats, energies: Floats, hidden: Bools, histogram: Floats, overflow: Floats,
) -> None:  # fmt: skip
    """Add the contributions that nothing hides."""
    for k in range(len(rows)):
        if not hidden[k]:
            overflow[rows[k]] += put(histogram[rows[k]], positions[k], energies[k])


@compiled()
def inside_pixels(
    position3: Floats, normal3: Floats, part3: Ints, direction: Floats, throughput: Floats, laser: Ints,
    position2: Floats, normal2: Floats, to_previous: Floats, part2: Ints, power: Floats, path: Floats, kind: Kinds,
    values: Floats, sensor: Floats, planes: Floats, solid_angle: Floats, patch_center: Floats, patch_reach: Floats,
    aperture_area: float, aperture_square: float, attenuation: float, points_per_vertex: int, first_laser: int,
    confocal: bool, pixels: int, split_of_part: Ints, splits: int, per_metre: float, clock_start: float,
    device_leg: Floats,
) -> Contributions:  # fmt: skip
    """Followed rays that landed inside a pixel: vertex, row, fractional bin and energy, if the sensor sees them."""
    owners, rows = [np.int64(0)], [np.int64(0)]
    positions, energies = [0.0], [0.0]
    for i in range(len(laser)):
        if part3[i] < 0 or throughput[i] <= 0.0:
            continue
        x3, n3, w = _at(position3, i), _at(normal3, i), _at(direction, i)
        span = (sensor[0] - x3[0], sensor[1] - x3[1], sensor[2] - x3[2])
        reach_square = dot(span, span)
        reach = math.sqrt(reach_square)
        out = (span[0] / reach, span[1] / reach, span[2] / reach)
        cos_sensor = dot(out, n3)
        cos3 = -dot(w, n3)
        if cos_sensor <= 0.0 or cos3 <= 0.0:
            continue
        local = laser[i] - first_laser
        k2, material2 = kind[part2[i]], values[part2[i]]
        for p in range(local if confocal else 0, local + 1 if confocal else pixels):
            inside = _is_near(position2[i], k2, patch_center[p], patch_reach[p])
            for k in range(4):
                inside = inside and dot(span, _at(planes[p], k)) <= 0.0
            if not inside:
                continue
            d = (x3[0] - position2[i, 0], x3[1] - position2[i, 1], x3[2] - position2[i, 2])
            square = dot(d, d)
            distance = math.sqrt(square)
            density = pdf(k2, material2, _at(normal2, i), _at(to_previous, i), w)
            followed = density * cos3 * solid_angle[p] * reach_square / (cos_sensor * points_per_vertex)
            f3 = evaluate(kind[part3[i]], values[part3[i]], n3, (-w[0], -w[1], -w[2]), out)
            energy = (
                power[i] * throughput[i] * (followed / (square + followed))
                * f3 * aperture_area * cos_sensor / (reach_square + aperture_square)
            )  # fmt: skip
            if attenuation > 0.0:
                energy *= math.exp(-attenuation * (distance + reach))
            if not energy > 0.0:
                continue
            owners.append(np.int64(i))
            rows.append((local if confocal else local * pixels + p) * splits + split_of_part[part2[i]])
            device = device_leg[local] + reach if device_leg[local] >= 0.0 else 0.0
            positions.append((path[i] + distance + device) * per_metre - clock_start)
            energies.append(energy)
    return np.array(owners[1:]), np.array(rows[1:]), np.array(positions[1:]), np.array(energies[1:])


@compiled()
def laser_points_in_pixels(
    laser: Ints, position1: Floats, normal1: Floats, to_laser: Floats, part1: Ints, leg: Floats, kind: Kinds,
    values: Floats, sensor: Floats, planes: Floats, aperture_area: float, aperture_square: float, attenuation: float,
    first_laser: int, confocal: bool, pixels: int, row_offset: int, splits: int, per_metre: float, clock_start: float,
    device_leg: Floats,
) -> Contributions:  # fmt: skip
    """Laser points a pixel looks at (one bounce): laser point, row, fractional bin, energy, if the sensor sees."""
    owners, rows = [np.int64(0)], [np.int64(0)]
    positions, energies = [0.0], [0.0]
    for i in range(len(laser)):
        o = laser[i]
        local = o - first_laser
        span = (sensor[0] - position1[o, 0], sensor[1] - position1[o, 1], sensor[2] - position1[o, 2])
        reach_square = dot(span, span)
        reach = math.sqrt(reach_square)
        out, n = (span[0] / reach, span[1] / reach, span[2] / reach), _at(normal1, o)
        f = evaluate(kind[part1[o]], values[part1[o]], n, _at(to_laser, o), out)
        energy = f * dot(out, n) * aperture_area / (reach_square + aperture_square)
        energy *= math.exp(-attenuation * (leg[o] + reach))
        if not energy > 0.0:
            continue
        for p in range(local if confocal else 0, local + 1 if confocal else pixels):
            inside = True
            for k in range(4):
                inside = inside and dot(span, _at(planes[p], k)) <= 0.0
            if not inside:
                continue
            owners.append(np.int64(o))
            rows.append((local if confocal else local * pixels + p) * splits + row_offset)
            device = device_leg[local] + reach if device_leg[local] >= 0.0 else 0.0
            positions.append(device * per_metre - clock_start)
            energies.append(energy)
    return np.array(owners[1:]), np.array(rows[1:]), np.array(positions[1:]), np.array(energies[1:])
