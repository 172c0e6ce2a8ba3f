"""What surfaces are made of: an albedo given by number, or materials of the catalogue."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import AfterValidator

from datagen.config.base import Settings, check_known
from datagen.config.distributions import Fraction, Uniform, draw
from datagen.config.scene_brdfs import BrdfSettings, CatalogueBrdf, LambertianBrdf
from datagen.records import Material
from scene_library.materials import MATERIALS


def _known_materials(names: tuple[str, ...]) -> tuple[str, ...]:
    for name in names:
        check_known(name, MATERIALS, "a material of the catalogue")
    return names


class SurfaceMaterial(Settings):
    """The material of one part: how much light it returns, and how it scatters it."""

    albedo: Fraction = Uniform(uniform=(0.3, 0.9))
    """Share of light that the surface returns."""
    material: Annotated[tuple[str, ...], AfterValidator(_known_materials)] = ()
    """Materials of the catalogue to draw from, instead of `albedo`: the reflectance is taken at
    `scene.wavelength_nm`, with a random tint inside the material's spread."""
    brdf: BrdfSettings = LambertianBrdf()
    """How the surface scatters; `kind: catalogue` takes the lobe that the catalogue gives for `material`."""

    def _check(self) -> None:
        if isinstance(self.brdf, CatalogueBrdf) and not self.material:
            raise ValueError("brdf: kind 'catalogue' takes the lobe of a catalogue material; name one under material")
        self._only_one_of("albedo", "material")

    def draw_material(self, wavelength_nm: float, rng: np.random.Generator) -> tuple[Material, str | None]:
        """A drawn material, and its name in the catalogue; None for an albedo given by number."""
        name = self.material[int(rng.integers(len(self.material)))] if self.material else None
        if name is None:
            albedo = draw(self.albedo, rng)
        else:
            albedo = MATERIALS[name].albedo(wavelength_nm, tint=2 * rng.random() - 1)
        if isinstance(self.brdf, CatalogueBrdf):
            assert name is not None
            return self.brdf.of(name, albedo), name
        return self.brdf.material(albedo, rng), name


class BrightSurface(SurfaceMaterial):
    """Relay wall and ceiling."""

    albedo: Fraction = Uniform(uniform=(0.6, 0.9))


class WallSurface(SurfaceMaterial):
    """Walls."""

    albedo: Fraction = Uniform(uniform=(0.5, 0.9))


class FloorSurface(SurfaceMaterial):
    """The floor."""

    albedo: Fraction = Uniform(uniform=(0.2, 0.7))


class DarkSurface(SurfaceMaterial):
    """The screen that hides the objects in the layout `isolated_wall`."""

    albedo: Fraction = Uniform(uniform=(0.05, 0.2))


class Materials(Settings):
    """The room's own surfaces; objects carry their material themselves."""

    relay_wall: BrightSurface = BrightSurface()
    walls: WallSurface = WallSurface()
    floor: FloorSurface = FloorSurface()
    ceiling: BrightSurface = BrightSurface()
    screen: DarkSurface = DarkSurface()
