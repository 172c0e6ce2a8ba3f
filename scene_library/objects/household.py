"""Things that stand about in rooms, halls and yards, metres."""

from __future__ import annotations

import numpy as np

from scene_library.solids import Solid, block, cylinder, ellipsoid, hollow, lathed, limb, moved, rotated, torus


def plant(rng: np.random.Generator) -> Solid:
    """A pot with a bush of leaves around a stem."""
    pot, tall = rng.uniform(0.22, 0.4), rng.uniform(0.2, 0.4)
    # Leaves grow between the rim of the tallest pot and 0.8 of the height.
    height = rng.uniform(0.6, 1.3)
    pieces = [
        lathed([(0, 0), (0.35 * pot, 0), (pot / 2, tall), (0, tall)]),
        limb((0, 0, tall), (0, 0, 0.8 * height), 0.02, 0.01),
    ]
    for k in range(int(rng.integers(8, 16))):
        a, up = k * 2.399963, rng.uniform(-0.2, 1.2)
        reach = rng.uniform(0.2, 0.45)
        leaf = ellipsoid((reach / 2, rng.uniform(0.03, 0.08), 0.006), (reach / 2, 0, 0), sides=8)
        leaf = rotated(rotated(leaf, "y", -np.degrees(up)), "z", np.degrees(a))
        pieces.append(moved(leaf, z=rng.uniform(tall + 0.03, 0.8 * height)))
    return Solid.compound(pieces)


def tree(rng: np.random.Generator) -> Solid:
    """A small conifer in a tub: stacked cones on a trunk."""
    height, size = rng.uniform(1.2, 2.0), rng.uniform(0.5, 0.9)
    tub = 0.25
    pieces = [cylinder(0.4 * size, tub), cylinder(0.07, 0.2, z=tub)]
    tiers = int(rng.integers(2, 5))
    step = (height - tub - 0.2) / tiers
    for k in range(tiers):
        low = tub + 0.2 + k * step
        wide = size / 2 * (1 - 0.8 * k / tiers)
        pieces.append(lathed([(0, low), (wide, low), (0.15 * wide, low + step), (0, low + step)]))
    return Solid.compound(pieces)


def waste_bin(rng: np.random.Generator) -> Solid:
    """An open bin, wider at the top."""
    size = rng.uniform(0.22, 0.45)
    return Solid.compound([hollow(0.8 * size, rng.uniform(0.9, 1.8) * size, 0.015, size)])


def wheelie_bin(rng: np.random.Generator) -> Solid:
    """A rubbish bin with two wheels and a lid."""
    width, depth, height = rng.uniform(0.48, 0.6), rng.uniform(0.5, 0.75), rng.uniform(0.9, 1.1)
    lid = moved(rotated(block(1.05 * width, 1.05 * depth, 0.05), "x", rng.uniform(0, 5)), z=height + 0.05)
    wheels = [rotated(cylinder(0.2, 0.05), "y", 90) for _ in range(2)]
    sides = [
        moved(w, s * (width / 2 + 0.026) - 0.025, depth / 2 - 0.1, 0.1) for w, s in zip(wheels, (-1, 1), strict=True)
    ]
    return Solid.compound([block(width, depth, height, z=0.04), lid, *sides])


def vase(rng: np.random.Generator) -> Solid:
    """A bellied vase."""
    height, belly = rng.uniform(0.25, 0.8), rng.uniform(0.3, 0.6)
    r = belly * height / 2
    neck, lip = rng.uniform(0.3, 0.6) * r, rng.uniform(0.5, 0.9) * r
    h = height
    outer = [(0, 0), (0.6 * r, 0), (0.9 * r, 0.2 * h), (r, 0.4 * h), (0.8 * r, 0.65 * h), (neck, 0.82 * h), (lip, h)]
    return Solid.compound([lathed([*outer, (0.8 * neck, 0.82 * h), (0, 0.8 * h)])])


def bottle(rng: np.random.Generator) -> Solid:
    """A bottle."""
    height, size = rng.uniform(0.2, 0.4), rng.uniform(0.06, 0.1)
    r, neck = size / 2, 0.3 * size / 2
    shoulder = rng.uniform(0.55, 0.7)
    h = height
    return Solid.compound(
        [lathed([(0, 0), (r, 0), (r, shoulder * h), (neck, (shoulder + 0.15) * h), (neck, h), (0, h)])]
    )


def suitcase(rng: np.random.Generator) -> Solid:
    """A suitcase on wheels, its handle pulled out."""
    width, depth, height = rng.uniform(0.35, 0.5), rng.uniform(0.2, 0.3), rng.uniform(0.5, 0.72)
    pull = rng.uniform(0.1, 0.4)
    rods = [block(0.015, 0.015, pull, s * 0.08, depth / 2 - 0.03, height + 0.05) for s in (-1, 1)]
    wheels = [cylinder(0.05, 0.05, sx * 0.4 * width, sy * 0.3 * depth) for sx in (-1, 1) for sy in (-1, 1)]
    grip = block(0.2, 0.03, 0.03, 0, depth / 2 - 0.03, height + 0.05 + pull)
    return Solid.compound([*wheels, block(width, depth, height, z=0.05), *rods, grip])


def carton(rng: np.random.Generator) -> Solid:
    """An open cardboard box with its flaps folded out."""
    width, depth, height = rng.uniform(0.3, 0.6), rng.uniform(0.25, 0.5), rng.uniform(0.2, 0.5)
    t = 0.006
    pieces = [block(width, depth, t)]
    pieces += [block(t, depth, height, s * (width - t) / 2, 0, t) for s in (-1, 1)]
    pieces += [block(width - 2 * t, t, height, 0, s * (depth - t) / 2, t) for s in (-1, 1)]
    flap = 0.45 * depth
    for s in (-1, 1):
        lid = moved(block(flap, depth, t), x=flap / 2)
        lid = rotated(lid, "y", -rng.uniform(-60, 40))
        if s < 0:
            lid = rotated(lid, "z", 180)
        pieces.append(moved(lid, s * width / 2, 0, height + t))
    return Solid.compound(pieces)


def ladder(rng: np.random.Generator) -> Solid:
    """A standing step ladder."""
    height, width, lean = rng.uniform(1.0, 2.0), rng.uniform(0.4, 0.55), rng.uniform(12, 18)
    reach = height * float(np.tan(np.radians(lean)))
    pieces = []
    for s in (-1, 1):
        pieces.append(limb((s * width / 2, -reach, 0), (s * 0.4 * width, -0.03, height), 0.02, 0.02))
        pieces.append(limb((s * width / 2, reach, 0), (s * 0.4 * width, 0.03, height), 0.016, 0.016))
    steps = int(height / 0.28)
    for k in range(1, steps + 1):
        z = k * height / (steps + 1)
        pieces.append(block(0.8 * width, 0.08, 0.02, 0, -reach * (1 - z / height) - 0.03, z))
    return Solid.compound(pieces)


def traffic_cone(rng: np.random.Generator) -> Solid:
    """A cone on a square foot."""
    height = rng.uniform(0.45, 0.9)
    foot = 0.55 * height
    cone = lathed([(0, 0.03), (0.2 * height, 0.03), (0.04 * height, height), (0, height)])
    return Solid.compound([block(foot, foot, 0.03), cone])


def barrel(rng: np.random.Generator) -> Solid:
    """A barrel."""
    size, height, bulge = rng.uniform(0.4, 0.6), rng.uniform(0.6, 0.95), rng.uniform(1.0, 1.2)
    z = np.linspace(0, 1, 7)
    r = size / 2 * (1 + (bulge - 1) * 4 * z * (1 - z))
    return Solid.compound([lathed([(0, 0), *zip(r, z * height, strict=True), (0, height)], 24)])


def fire_extinguisher(rng: np.random.Generator) -> Solid:
    """A fire extinguisher with its hose."""
    height, size = rng.uniform(0.45, 0.6), rng.uniform(0.14, 0.19)
    r = size / 2
    body = lathed(
        [(0, 0), (r, 0), (r, 0.75 * height), (0.3 * r, 0.88 * height), (0.3 * r, 0.9 * height), (0, 0.9 * height)]
    )
    grip = block(0.03, 0.16, 0.1 * height, 0, -0.04, 0.9 * height)
    hose = limb((0.5 * r, -0.02, 0.88 * height), (1.3 * r, -0.05, 0.35 * height), 0.012, 0.016)
    return Solid.compound([body, grip, hose])


def tyre(rng: np.random.Generator) -> Solid:
    """A car tyre, lying or standing."""
    r = rng.uniform(0.28, 0.36)
    ring = torus(0.75 * r, 0.25 * r)
    return Solid.compound([rotated(ring, "x", 90) if rng.random() < 0.5 else ring])


def bicycle(rng: np.random.Generator) -> Solid:
    """A bicycle from wheels and tubes, along x."""
    r, base = rng.uniform(0.3, 0.36), rng.uniform(0.95, 1.1)
    tube = 0.017
    wheels = [moved(rotated(torus(r, 0.02, 28, 6), "x", 90), s * base / 2, 0, r + 0.02) for s in (-1, 1)]
    z0 = r + 0.02
    rear, front = (-base / 2, 0, z0), (base / 2, 0, z0)
    crank, seat, head = (-0.05, 0, z0 - 0.03), (-0.2, 0, z0 + 0.5), (base / 2 - 0.14, 0, z0 + 0.48)
    frame = [(rear, crank), (rear, seat), (crank, seat), (seat, head), (crank, head), (head, front)]
    pieces = [limb(a, b, tube, tube, 8) for a, b in frame]
    bars = limb((head[0], -0.27, z0 + 0.6), (head[0], 0.27, z0 + 0.6), 0.013, 0.013, 8)
    stem = limb(head, (head[0], 0, z0 + 0.6), tube, tube, 8)
    hubs = [moved(rotated(cylinder(0.06, 0.08), "x", 90), s * base / 2, 0.04, z0) for s in (-1, 1)]
    return Solid.compound([*wheels, *pieces, *hubs, bars, stem, block(0.25, 0.13, 0.06, -0.22, 0, z0 + 0.5)])


def stairs(rng: np.random.Generator) -> Solid:
    """A short flight of steps, rising to +y."""
    steps, width = int(rng.integers(2, 6)), rng.uniform(0.5, 1.0)
    rise, tread = rng.uniform(0.15, 0.2), rng.uniform(0.22, 0.3)
    return Solid.compound([block(width, tread, (k + 1) * rise, 0, k * tread) for k in range(steps)])


def radiator(rng: np.random.Generator) -> Solid:
    """A ribbed radiator."""
    width, height, ribs = rng.uniform(0.6, 1.4), rng.uniform(0.5, 0.7), int(rng.integers(6, 16))
    pitch = width / ribs
    columns = [block(0.6 * pitch, 0.1, height, (k - (ribs - 1) / 2) * pitch, 0, 0.1) for k in range(ribs)]
    pipes = [block(width, 0.03, 0.03, 0, 0, z) for z in (0.07, 0.1 + height)]
    feet = [block(0.03, 0.08, 0.07, s * 0.4 * width) for s in (-1, 1)]
    return Solid.compound([*columns, *pipes, *feet])
