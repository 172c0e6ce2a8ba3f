"""What the light before a sensor is divided into, each piece in proportion to a number that a linear fit finds.

Without options the pieces are the light of one bounce of each part of a mesh, and the numbers are its albedos. Two
options divide further:

    bounces   light of two bounces, for each part that light meets first and each that it meets next. The number is
              the product of two albedos if both surfaces are matt, the albedos right, and the beam's light outside of
              the zones as the device says.
    angles    light of one bounce by the cosine of its angle, at `COSINES`. The number is π f, the BRDF back to where
              light comes from over that of a white matt surface, since light and sensor stand side by side.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from datagen.devices.agreement import Fitted
from datagen.errors import InputError
from datagen.records import Capture, Lambertian, Material, MeasuredByAngle, Scene
from datagen.records.arrays import Bools, Floats
from datagen.transport.brdf import MaterialTable, albedo
from datagen.transport.flood import light_at_sensor, one_bounce_by_angle, one_bounce_of_beam, two_bounces_of_beam
from datagen.transport.rays import Raycaster
from datagen.transport.reference import brdf

COSINES = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Cosines at which the reflectance of a part is fitted; with nine, held-out frames of a pyramid are no nearer."""
TWO_BOUNCE_RAYS = 2
"""Rays of the light of two bounces for each of one bounce: it is a few hundredths of all, and twice as noisy."""
MIDDLES = 1 << 12
"""Cosines over which the share of light that leaves a surface is taken as its mean, to 10⁻⁶."""
UNIT = 0.5
"""Albedo that light is simulated with and then divided by."""


@dataclass(frozen=True)
class Pieces:
    """The pieces of the light before a mesh.

    parts : (K,) names. angles, bounces : the options of the module.
    """

    parts: tuple[str, ...]
    angles: bool = False
    bounces: bool = False

    @property
    def cosines(self) -> tuple[float, ...]:
        """(N,) nodes of the reflectance of each part."""
        return COSINES if self.angles else (1.0,)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the numbers of all pieces, in their order: of parts by node, then of pairs of parts."""
        names = [f"albedo of {part}" for part in self.parts]
        if self.angles:
            names = [f"reflectance of {part} at cosine {c:g}" for part, c in product(self.parts, COSINES)]
        if self.bounces:
            names += [f"two bounces, {first} then {second}" for first, second in product(self.parts, repeat=2)]
        return tuple(names)

    def light(self, scene: Scene, capture: Capture, caster: Raycaster, materials: MaterialTable, rays: int) -> Floats:
        """(pieces, zones, steps) light of each piece where its number is 1, as the zones record it."""
        if self.angles:
            once, _ = one_bounce_by_angle(scene, capture, caster, materials, COSINES, rays)
        else:
            once = one_bounce_of_beam(scene, capture, caster, materials, rays).light
        pieces = [once.reshape(-1, *once.shape[-2:]) / UNIT]
        if self.bounces:
            twice = two_bounces_of_beam(scene, capture, caster, materials, TWO_BOUNCE_RAYS * rays)
            pieces.append(twice.reshape(-1, *twice.shape[-2:]) / UNIT**2)
        return np.stack([light_at_sensor(piece[None], capture)[0] for piece in np.concatenate(pieces)])

    def differences(self) -> Floats:
        """(rows, pieces) rows that give the differences of reflectances of neighbouring angles of each part."""
        nodes, parts = len(self.cosines), len(self.parts)
        rows = np.kron(np.eye(parts), np.diff(np.eye(nodes), axis=0))
        return np.pad(rows, ((0, 0), (0, parts**2 * self.bounces)))

    def reflectances(self, values: Floats, seen: Bools) -> dict[str, tuple[float, ...]]:
        """Part that was seen → its reflectances at the nodes, from the numbers of all pieces."""
        nodes = len(self.cosines)
        of_parts = {part: slice(k * nodes, (k + 1) * nodes) for k, part in enumerate(self.parts)}
        return {part: tuple(map(float, values[of])) for part, of in of_parts.items() if seen[of].any()}

    def by_name(self, values: Floats, errors: Floats, seen: Bools) -> dict[str, Fitted]:
        """Name → number with its standard error, of the pieces (pieces,) that were `seen` at all."""
        return {
            name: Fitted(float(value), float(error))
            for name, value, error, there in zip(self.names, values, errors, seen, strict=True)
            if there
        }


def reflectance_of(material: Material, cosines: Floats) -> Floats:
    """(…) π f of a material back to where light comes from, at cosines (…): `material_of` read the other way."""
    table = MaterialTable.of((material,))
    c = np.asarray(cosines, np.float64).ravel()
    along = np.stack([np.sqrt(np.maximum(1 - c**2, 0.0)), np.zeros_like(c), c], axis=1)
    up = np.tile([0.0, 0.0, 1.0], (len(c), 1))
    f = brdf(table.kind, table.values, np.zeros(len(c), np.int64), up, along, along)
    return np.asarray(np.pi * f).reshape(np.shape(cosines))


def material_of(part: str, reflectance: tuple[float, ...]) -> Material:
    """The material whose light back to where it comes from is that of a white matt surface times the reflectance, at
    one cosine (matt) or at evenly spaced ones.

    Raises `InputError` for a surface from which more light would leave than arrives.
    """
    if not any(reflectance):
        return Lambertian(0.0)
    table = reflectance * 2 if len(reflectance) == 1 else reflectance
    # With the albedo 1, π f at the brightest node is g_max / ḡ, and of the light g / g_max leaves: ḡ / g_max of all.
    cosines = (np.arange(MIDDLES) + 0.5) / MIDDLES
    most = max(table) * float((2 * cosines * albedo(MeasuredByAngle(1.0, table), cosines)).mean())
    if most > 1:
        raise InputError(
            f"{part}: {most:.2f} of the light would leave it; reflectances are relative to the light that the device "
            "says it emits: raise counting.photons_per_pulse in a device file (`datagen compare --out` writes one)"
        )
    return Lambertian(most) if len(reflectance) == 1 else MeasuredByAngle(most, table)
