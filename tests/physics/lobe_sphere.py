"""Cells that cover all directions and are fine where a material's lobe is; the compiled BRDFs at many directions."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from every_brdf import kind_of
from numpy.typing import NDArray

from datagen import GGX
from datagen.compiled import compiled
from datagen.records import Material
from datagen.transport import brdf
from datagen.transport.brdf import MaterialTable, model_of

AZIMUTH = 0.7
NORMAL = np.array([-0.6, 0.64, -0.48])
RINGS, TURNS = 600, 360
GROUPS = 12
EVEN = 1e6
"""Value of `crowd` that is so large that sectors are even."""


@compiled()
def draw(kind, values, n, w_in, uv):  # type: ignore[no-untyped-def]
    out = np.empty((len(uv), 3))
    for i in range(len(uv)):
        w = brdf.sample(kind, values, (n[0], n[1], n[2]), (w_in[0], w_in[1], w_in[2]), uv[i, 0], uv[i, 1])
        out[i, 0], out[i, 1], out[i, 2] = w
    return out


@compiled()
def values_along(kind, values, n, w_in, w_out):  # type: ignore[no-untyped-def]
    """(n,) BRDF and (n,) pdf for one or n incoming directions and n outgoing ones."""
    f, density = np.empty(len(w_out)), np.empty(len(w_out))
    normal = (n[0], n[1], n[2])
    for i in range(len(w_out)):
        a = w_in[i if len(w_in) > 1 else 0]
        b = (w_out[i, 0], w_out[i, 1], w_out[i, 2])
        f[i] = brdf.evaluate(kind, values, normal, (a[0], a[1], a[2]), b)
        density[i] = brdf.pdf(kind, values, normal, (a[0], a[1], a[2]), b)
    return f, density


@compiled()
def most_along(kind, values, n, w_in, w_out, turn, tilt):  # type: ignore[no-untyped-def]
    """(n,) `evaluate_at_most` for n incoming and n outgoing directions."""
    most = np.empty(len(w_out))
    for i in range(len(w_out)):
        a, b = (w_in[i, 0], w_in[i, 1], w_in[i, 2]), (w_out[i, 0], w_out[i, 1], w_out[i, 2])
        most[i] = brdf.evaluate_at_most(kind, values, (n[0], n[1], n[2]), a, b, turn, tilt)
    return most


@compiled()
def widened(kind, values, span):  # type: ignore[no-untyped-def]
    """A material's row with its lobe widened by an angle."""
    row = values.copy()
    brdf.widen(kind, row, span)
    return row


def row_of(material: Material) -> tuple[np.integer, NDArray[np.float64]]:
    table = MaterialTable.of((material,))
    return table.kind[0], table.values[0]


def tangents(n: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    helper = np.eye(3)[np.argmin(np.abs(n))]
    t = np.cross(n, helper) / np.linalg.norm(np.cross(n, helper))
    return t, np.cross(n, t)


def about(axis: NDArray[np.float64], one_minus_cos: NDArray, azimuth: NDArray) -> NDArray[np.float64]:
    """Unit vectors (…, 3) at given 1 − cos of the angle from the axis and azimuths about it."""
    t, b = tangents(axis)
    sine = np.sqrt(np.maximum(one_minus_cos * (2 - one_minus_cos), 0))
    x, y, z = sine * np.cos(azimuth), sine * np.sin(azimuth), 1 - one_minus_cos
    return x[..., None] * t + y[..., None] * b + z[..., None] * axis


def incoming(cosine: float, azimuth: float = AZIMUTH, n: NDArray[np.float64] = NORMAL) -> NDArray[np.float64]:
    return about(n, np.array(1 - cosine), np.array(azimuth))


def lobe_axis(material: Material, w_in: NDArray[np.float64], n: NDArray[np.float64] = NORMAL) -> NDArray[np.float64]:
    axes = {"normal": n, "mirror": 2 * (n @ w_in) * n - w_in, "incoming": w_in}
    return axes[kind_of(material).axis]


@dataclass(frozen=True)
class Sphere:
    """All directions in cells about an axis: rings × TURNS sectors, fine where a material's lobe is.

    edges : (rings + 1,) of x = 1 − cos of the angle from the axis. Sectors are counted from t in even steps of
    log(1 + |φ|/crowd), so that they crowd about t where `crowd` is small.
    """

    axis: NDArray[np.float64]
    t: NDArray[np.float64]
    b: NDArray[np.float64]
    edges: NDArray[np.float64]
    crowd: float

    @classmethod
    def about_lobe(cls, material: Material, w_in: NDArray[np.float64], rings: int, n: NDArray[np.float64]) -> Sphere:
        if not isinstance(material, GGX):
            axis = lobe_axis(material, w_in, n)
            # An edge at the horizon where the axis allows it.
            first, end = width_of(material), 1.0 if axis is n else 2.0
            edges = np.exp(np.linspace(math.log(first), math.log(end + first), rings + 1)) - first
            return cls(axis, *tangents(axis), edges, EVEN)
        # Facets send light about the mirror direction and, scattered again, out at grazing: about the normal, rings
        # crowd at both; the lobe is narrower by cosθ across the plane of incidence than within it.
        alpha, cosine = material.roughness**2, float(np.clip(n @ w_in, 0, 1))
        theta = np.linspace(0, np.pi / 2, 200_001)
        middle = (theta[:-1] + theta[1:]) / 2
        density = 1 / (np.abs(middle - math.acos(cosine)) + alpha) + 0.5 / (np.pi / 2 - middle + 0.1 * alpha)
        cumulative = np.append(0, np.cumsum(density))
        edges = 1 - np.cos(np.interp(np.linspace(0, cumulative[-1], rings + 1), cumulative, theta))
        inside = cosine * n - w_in
        if np.linalg.norm(inside) < 1e-6:
            return cls(n, *tangents(n), edges, EVEN)
        t = inside / np.linalg.norm(inside)
        sine = math.sqrt(1 - cosine**2)
        return cls(n, t, np.cross(n, t), edges, alpha * max(cosine, alpha) / sine**2)

    def directions(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Centres of the cells (rings · TURNS, 3) and their solid angles (rings, TURNS)."""
        x = (self.edges[:-1] + self.edges[1:]) / 2
        phi = self._azimuth((np.arange(TURNS) + 0.5) / TURNS * 2 * np.pi - np.pi)
        width = np.diff(self._azimuth(np.arange(TURNS + 1) / TURNS * 2 * np.pi - np.pi))
        across = np.cos(phi)[:, None] * self.t + np.sin(phi)[:, None] * self.b
        w = (1 - x)[:, None, None] * self.axis + np.sqrt(x * (2 - x))[:, None, None] * across
        return w.reshape(-1, 3), np.outer(np.diff(self.edges), width)

    def _azimuth(self, psi: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.sign(psi) * self.crowd * np.expm1(np.abs(psi) / np.pi * np.log1p(np.pi / self.crowd))

    def counts(self, w: NDArray[np.float64]) -> NDArray[np.float64]:
        """Numbers of the directions (n, 3) that lie in each of GROUPS × GROUPS groups of cells."""
        phi = np.arctan2(w @ self.b, w @ self.t)
        psi = np.sign(phi) * np.pi * np.log1p(np.abs(phi) / self.crowd) / np.log1p(np.pi / self.crowd)
        # |difference|²/2 keeps the digits of a small angle that 1 − cos would lose.
        x = np.sum((w - self.axis) ** 2, axis=1) / 2
        sectors = np.linspace(-np.pi, np.pi, GROUPS + 1)
        return np.histogram2d(x, psi, (self.edges[:: len(self.edges) // GROUPS], sectors))[0]


@dataclass(frozen=True)
class Integrals:
    """Integrals over all directions: ∫ f cosθ_out dω, and ∫ pdf dω in GROUPS × GROUPS groups of a sphere's cells."""

    power: float
    mass: NDArray[np.float64]
    sphere: Sphere


@cache
def integrals(
    material: Material, incoming: tuple[float, ...], normal: tuple[float, ...] = tuple(NORMAL)
) -> Integrals:
    """The integrals for a material with this normal, lit from the direction `incoming`."""
    w_in, n = np.array(incoming), np.array(normal)
    sphere = Sphere.about_lobe(material, w_in, RINGS, n)
    w_out, area = sphere.directions()
    f, density = values_along(*row_of(material), n, w_in[None], w_out)
    mass = (density.reshape(area.shape) * area).reshape(GROUPS, RINGS // GROUPS, GROUPS, TURNS // GROUPS)
    return Integrals(float((f * (w_out @ n) * area.ravel()).sum()), mass.sum(axis=(1, 3)), sphere)


def width_of(material: Material) -> float:
    """1 − cos of an angle well inside the lobe: the scale on which cells are laid out."""
    return 0.5 * (1 - math.cos(min(model_of(material).lobe_width_rad(material), math.pi / 2)))
