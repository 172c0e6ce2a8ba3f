"""Figures from primitives: a mannequin in many poses, standing, walking and seated; a child; a dog. They face −y."""

from __future__ import annotations

import numpy as np

from scene_library.arrays import Floats
from scene_library.solids import Solid, Surface, ellipsoid, limb


def _direction(angle_forward: float, angle_out: float, side: float) -> Floats:
    """A downward limb swung forward (towards −y) and outward by angles in radians."""
    return np.array(
        [
            side * np.sin(angle_out),
            -np.sin(angle_forward) * np.cos(angle_out),
            -np.cos(angle_forward) * np.cos(angle_out),
        ]
    )


def _arm(shoulder: Floats, side: float, length: float, girth: float, rng: np.random.Generator) -> list[Surface]:
    swing, spread, bend = rng.uniform(-0.5, 1.2), rng.uniform(0.05, 0.9), rng.uniform(0.0, 1.4)
    elbow = shoulder + 0.5 * length * _direction(swing, spread, side)
    hand = elbow + 0.45 * length * _direction(swing + bend, 0.3 * spread, side)
    return [
        limb(shoulder, elbow, girth, 0.8 * girth),
        limb(elbow, hand, 0.8 * girth, 0.6 * girth),
        ellipsoid((0.8 * girth, 0.6 * girth, 1.4 * girth), hand, 10),
    ]


def _figure(height: float, head_share: float, rng: np.random.Generator, seated: bool) -> Solid:
    """Proportions of a standing body as shares of its height; legs step apart, or bend on a seat."""
    h = height
    head, leg = head_share * h, 0.47 * h
    build = rng.uniform(0.85, 1.15)
    girth, shoulders, hips = 0.03 * h * build, 0.115 * h * build, 0.055 * h * build
    stride = 0.0 if seated else rng.uniform(0.0, 0.45)
    waist = 0.26 * h if seated else leg * float(np.cos(stride))
    neck = waist + (1 - 0.47) * h - 1.35 * head
    pieces = [
        ellipsoid((0.42 * head, 0.48 * head, 0.6 * head), (0, 0, neck + 0.75 * head), 16),
        limb((0, 0, neck - 0.02 * h), (0, 0, neck + 0.3 * head), 0.28 * head, 0.25 * head),
        ellipsoid((shoulders, 0.62 * shoulders, 0.55 * (neck - waist)), (0, 0, waist + 0.55 * (neck - waist)), 16),
        ellipsoid((0.09 * h * build, 0.065 * h * build, 0.07 * h), (0, 0, waist + 0.02 * h), 16),
    ]
    for side in (-1.0, 1.0):
        shoulder = np.array([side * 0.95 * shoulders, 0.0, neck - 0.03 * h])
        pieces += _arm(shoulder, side, 0.42 * h, girth, rng)
        hip = np.array([side * hips, 0.0, waist])
        thigh, shank = (np.pi / 2 - 0.05, rng.uniform(-0.2, 0.2)) if seated else (side * stride, side * stride - 0.05)
        knee = hip + 0.5 * leg * _direction(thigh, 0.04, side)
        foot = knee + 0.5 * leg * _direction(shank, 0.0, side)
        pieces += [
            limb(hip, knee, 1.7 * girth, 1.2 * girth),
            limb(knee, foot, 1.2 * girth, 0.8 * girth),
            ellipsoid((girth, 0.075 * h, 0.025 * h), foot + np.array([0.0, -0.035 * h, 0.0]), 10),
        ]
    if seated:
        pieces.append(limb((0, 0, 0), (0, 0, waist - 0.06 * h), 0.11 * h, 0.11 * h, 16))
    return Solid.compound(pieces)


def mannequin(rng: np.random.Generator) -> Solid:
    """A grown person, standing or walking."""
    return _figure(rng.uniform(1.5, 1.95), 0.13, rng, seated=False)


def child(rng: np.random.Generator) -> Solid:
    """A child, standing or walking, its head larger for its height."""
    return _figure(rng.uniform(0.9, 1.4), 0.165, rng, seated=False)


def seated_person(rng: np.random.Generator) -> Solid:
    """A grown person on a round stool."""
    return _figure(rng.uniform(1.5, 1.9), 0.13, rng, seated=True)


def dog(rng: np.random.Generator) -> Solid:
    """A dog on four legs."""
    h = rng.uniform(0.35, 0.7)
    length, r = rng.uniform(1.0, 1.3) * h, 0.2 * h
    spine = 0.75 * h
    head = np.array([0.0, -0.62 * length, h])
    nose = head + np.array([0.0, -0.36 * h, -0.03 * h])
    tail = (0, 0.8 * length, spine + rng.uniform(-0.1, 0.4) * h)
    pieces = [
        ellipsoid((r, 0.55 * length, r), (0, 0, spine), 16),
        limb((0, -0.42 * length, spine + 0.05 * h), head, 0.12 * h, 0.1 * h),
        ellipsoid((0.13 * h, 0.2 * h, 0.13 * h), head + np.array([0.0, -0.05 * h, 0.03 * h]), 14),
        limb(head + np.array([0.0, -0.15 * h, 0.0]), nose, 0.09 * h, 0.05 * h),
        limb((0, 0.5 * length, spine + 0.05 * h), tail, 0.04 * h, 0.02 * h),
    ]
    for side in (-1, 1):
        ear, tip = (head + np.array([side * out * h, 0, up * h]) for out, up in ((0.08, 0.08), (0.12, 0.26)))
        pieces.append(limb(ear, tip, 0.05 * h, 0.01 * h))
        for y in (-0.38, 0.38):
            swing = rng.uniform(-0.12, 0.12) * h
            x, y_m = side * 0.6 * r, y * length
            pieces.append(limb((x, y_m, spine), (x, y_m + swing, 0), 0.07 * h, 0.04 * h))
    return Solid.compound(pieces)
