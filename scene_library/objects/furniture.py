"""Furniture of everyday proportions, metres. Backs stand at +y, so that a piece can be put against a wall."""

from __future__ import annotations

import numpy as np

from scene_library.solids import Solid, Surface, block, cylinder, ellipsoid, lathed, limb, moved, rotated


def _legs(width: float, depth: float, height: float, thick: float) -> list[Surface]:
    x, y = (width - thick) / 2, (depth - thick) / 2
    return [block(thick, thick, height, sx * x, sy * y) for sx in (-1, 1) for sy in (-1, 1)]


def chair(rng: np.random.Generator) -> Solid:
    """A chair with four legs and a back of one to three slats."""
    width, depth = rng.uniform(0.38, 0.5), rng.uniform(0.38, 0.5)
    seat, back, leg = rng.uniform(0.42, 0.5), rng.uniform(0.35, 0.55), rng.uniform(0.03, 0.05)
    board = 0.03
    pieces = [*_legs(width, depth, seat, leg), block(width, depth, board, z=seat)]
    posts = [block(leg, leg, back, s * (width - leg) / 2, (depth - leg) / 2, seat + board) for s in (-1, 1)]
    rails = int(rng.integers(1, 4))
    tall = back / (2 * rails)
    slats = [
        block(width - 2 * leg, 0.6 * leg, tall, 0, (depth - leg) / 2, seat + board + back - (2 * k + 1) * tall)
        for k in range(rails)
    ]
    return Solid.compound([*pieces, *posts, *slats])


def stool(rng: np.random.Generator) -> Solid:
    """A round stool on four splayed legs."""
    size, height, thick = rng.uniform(0.28, 0.4), rng.uniform(0.42, 0.75), 0.04
    spread = rng.uniform(1.0, 1.3)
    r = 0.35 * size
    corners = [(sx, sy) for sx in (-1, 1) for sy in (-1, 1)]
    legs = [limb((x * r * spread, y * r * spread, 0), (x * r, y * r, height), 0.017, 0.022) for x, y in corners]
    return Solid.compound([*legs, cylinder(size, thick, z=height)])


def armchair(rng: np.random.Generator) -> Solid:
    """An upholstered chair with arms."""
    width, depth = rng.uniform(0.7, 0.95), rng.uniform(0.7, 0.9)
    seat, arm, back = rng.uniform(0.36, 0.44), rng.uniform(0.55, 0.65), rng.uniform(0.75, 1.0)
    side = rng.uniform(0.12, 0.2)
    return Solid.compound(_upholstery(width, depth, seat, arm, back, side))


def sofa(rng: np.random.Generator) -> Solid:
    """An upholstered bench with arms."""
    width, depth = rng.uniform(1.5, 2.3), rng.uniform(0.8, 1.0)
    seat, arm, back = rng.uniform(0.36, 0.44), rng.uniform(0.55, 0.65), rng.uniform(0.7, 0.9)
    return Solid.compound(_upholstery(width, depth, seat, arm, back, rng.uniform(0.12, 0.25)))


def _upholstery(width: float, depth: float, seat: float, arm: float, back: float, side: float) -> list[Surface]:
    inner = width - 2 * side
    return [
        block(side, depth, arm, -(width - side) / 2),
        block(side, depth, arm, (width - side) / 2),
        block(inner, depth - side, seat, 0, -side / 2),
        block(inner, side, back, 0, (depth - side) / 2),
    ]


def table(rng: np.random.Generator) -> Solid:
    """A table on four legs."""
    width, depth = rng.uniform(0.9, 1.8), rng.uniform(0.6, 0.95)
    height, board, leg = rng.uniform(0.68, 0.76), rng.uniform(0.02, 0.05), rng.uniform(0.04, 0.08)
    inset = rng.uniform(0.9, 1.0)
    return Solid.compound([*_legs(inset * width, inset * depth, height, leg), block(width, depth, board, z=height)])


def round_table(rng: np.random.Generator) -> Solid:
    """A round table on one post."""
    size, height, board = rng.uniform(0.6, 1.2), rng.uniform(0.6, 0.78), 0.03
    foot, post = rng.uniform(0.4, 0.6) * size, rng.uniform(0.05, 0.1)
    legs = [cylinder(foot, board, sides=28), cylinder(post, height - board, z=board)]
    return Solid.compound([*legs, cylinder(size, board, z=height, sides=32)])


def desk(rng: np.random.Generator) -> Solid:
    """A desk with a chest of drawers on one side."""
    width, depth, height = rng.uniform(1.1, 1.7), rng.uniform(0.6, 0.8), rng.uniform(0.7, 0.75)
    chest, side = rng.uniform(0.35, 0.45), 0.03
    x = (width - side) / 2
    return Solid.compound(
        [
            block(chest, depth, height, -(width - chest) / 2),
            block(side, depth, height, x),
            block(width, depth, side, z=height),
            block(width - chest - side, side, 0.5 * height, (chest - side) / 2, 0.4 * depth, 0.5 * height),
        ]
    )


def bed(rng: np.random.Generator) -> Solid:
    """A bed with mattress, headboard and one or two pillows."""
    width, length = rng.uniform(0.9, 1.8), rng.uniform(1.95, 2.1)
    frame, mattress, head = rng.uniform(0.2, 0.32), rng.uniform(0.15, 0.25), rng.uniform(0.75, 1.1)
    pillows = 1 if width < 1.3 else 2
    share = width / pillows
    top = frame + mattress
    pieces = [block(width, length, frame), block(0.97 * width, 0.98 * length, mattress, z=frame)]
    pieces.append(block(width, 0.06, head, y=length / 2 + 0.03))
    for k in range(pillows):
        x = (k - (pillows - 1) / 2) * 0.95 * share
        pieces.append(block(0.8 * share, 0.4, 0.1, x, length / 2 - 0.28, top))
    return Solid.compound(pieces)


def shelf(rng: np.random.Generator) -> Solid:
    """An open shelf with a back, some boards holding books."""
    width, depth, height = rng.uniform(0.6, 1.2), rng.uniform(0.25, 0.4), rng.uniform(1.0, 2.0)
    boards, thick = int(rng.integers(3, 7)), 0.025
    inner = width - 2 * thick
    step = (height - thick) / (boards - 1)
    sides = [block(thick, depth, height, s * (width - thick) / 2) for s in (-1, 1)]
    levels = [block(inner, depth - thick, thick, 0, -thick / 2, k * step) for k in range(boards)]
    back = block(inner, thick, height, 0, (depth - thick) / 2)
    books = []
    for k in range(boards - 1):
        if rng.random() < 0.6:
            wide, tall = rng.uniform(0.2, 0.8) * inner, rng.uniform(0.4, 0.8) * (step - thick)
            books.append(block(wide, 0.6 * depth, tall, 0, -0.1 * depth, k * step + thick))
    return Solid.compound([*sides, *levels, back, *books])


def cabinet(rng: np.random.Generator) -> Solid:
    """A low cabinet with one to three doors."""
    width, depth, height = rng.uniform(0.6, 1.4), rng.uniform(0.35, 0.5), rng.uniform(0.7, 1.1)
    foot = rng.uniform(0.05, 0.15)
    body = moved(block(width, depth, height - foot), z=foot)
    doors = int(rng.integers(1, 4))
    share = width / doors
    tall, y = 0.94 * (height - foot), -depth / 2 - 0.01
    middles = [(k - (doors - 1) / 2) * share for k in range(doors)]
    fronts = [block(0.94 * share, 0.02, tall, x, y, foot + 0.02) for x in middles]
    return Solid.compound([*_legs(0.9 * width, 0.9 * depth, foot, 0.05), body, *fronts])


def wardrobe(rng: np.random.Generator) -> Solid:
    """A wardrobe with two handles."""
    width, depth, height = rng.uniform(0.8, 1.8), rng.uniform(0.5, 0.65), rng.uniform(1.7, 2.1)
    handle = 0.02
    handles = [block(handle, 0.03, 0.2, s * 0.04, -depth / 2 - 0.015, 0.5 * height) for s in (-1, 1)]
    return Solid.compound([block(width, depth, height), *handles])


def coat_stand(rng: np.random.Generator) -> Solid:
    """A post with hooks on a round foot."""
    height, foot = rng.uniform(1.6, 1.9), rng.uniform(0.35, 0.5)
    hooks = int(rng.integers(4, 8))
    pieces = [cylinder(foot, 0.03), cylinder(0.04, height - 0.03, z=0.03)]
    for k in range(hooks):
        a = 2 * np.pi * k / hooks
        c, s = float(np.cos(a)), float(np.sin(a))
        pieces.append(limb((0.02 * c, 0.02 * s, 0.9 * height), (0.17 * c, 0.17 * s, 0.97 * height), 0.012, 0.01))
    return Solid.compound(pieces)


def floor_lamp(rng: np.random.Generator) -> Solid:
    """A lamp on a tall post."""
    height, shade = rng.uniform(1.3, 1.8), rng.uniform(0.3, 0.5)
    tall = rng.uniform(0.2, 0.35)
    lampshade = lathed([(0, height - tall), (shade / 2, height - tall), (0.35 * shade, height), (0, height)])
    return Solid.compound(
        [cylinder(rng.uniform(0.25, 0.35), 0.03), cylinder(0.03, height - tall - 0.03, z=0.03), lampshade]
    )


def pendant_lamp(rng: np.random.Generator) -> Solid:
    """A lampshade on its cord."""
    size, cord = rng.uniform(0.25, 0.5), rng.uniform(0.3, 0.8)
    tall = rng.uniform(0.5, 0.9) * size
    shade = lathed([(0, 0), (size / 2, 0), (0.15 * size, tall), (0, tall)])
    return Solid.compound([shade, cylinder(0.015, cord, z=tall, sides=8), cylinder(0.1, 0.03, z=tall + cord)])


def monitor(rng: np.random.Generator) -> Solid:
    """A screen on a foot, as on a desk or a low board."""
    width = rng.uniform(0.5, 1.3)
    tall, post = 0.58 * width, rng.uniform(0.08, 0.18)
    tilt = rng.uniform(0, 8)
    screen = moved(rotated(block(width, 0.04, tall), "x", tilt), z=post + 0.02)
    return Solid.compound([block(0.4 * width, 0.22, 0.02), block(0.06, 0.04, post, z=0.02), screen])


def whiteboard(rng: np.random.Generator) -> Solid:
    """A board on two feet."""
    width, height = rng.uniform(1.0, 1.8), rng.uniform(1.7, 1.95)
    board = rng.uniform(0.9, 1.1)
    frame = [block(0.04, 0.04, height, s * (width / 2 + 0.02)) for s in (-1, 1)]
    feet = [block(0.04, 0.5, 0.04, s * (width / 2 + 0.06)) for s in (-1, 1)]
    return Solid.compound([*frame, *feet, block(width, 0.02, board, z=height - board)])


def beanbag(rng: np.random.Generator) -> Solid:
    """A flattened ball of cloth."""
    size = rng.uniform(0.7, 1.0)
    return Solid.compound([ellipsoid((size / 2, size / 2, rng.uniform(0.3, 0.42) * size))])
