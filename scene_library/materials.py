"""A catalogue of real materials: diffuse reflectance near four laser lines, and how they depart from Lambert's law.

Every number here is an `estimate`: none was read from a measurement that we could name. `reasoning` says what each
estimate rests on. `spread` is the half-width of the range of samples one meets under that name (colour, wear, dirt).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

WAVELENGTHS_NM = (532.0, 670.0, 905.0, 1550.0)
"""Laser lines that the catalogue gives values for: green, red, and the two usual lidar bands."""


@dataclass(frozen=True)
class Brdf:
    """Departure from a Lambertian surface, all estimates.

    Attributes
    ----------
    specular : share of the reflected light that is scattered around the mirror direction at normal incidence.
    exponent : Phong exponent of that lobe (about 2/roughness² − 2); 0 where there is no lobe.
    retro : share that goes back towards the source.
    """

    specular: float = 0.0
    exponent: float = 0.0
    retro: float = 0.0


@dataclass(frozen=True)
class CatalogueMaterial:
    """One material.

    Attributes
    ----------
    reflectance : hemispherical reflectance at each of `WAVELENGTHS_NM`, 0 … 1.
    spread : half-width of the range of reflectances met under this name.
    brdf : how it departs from Lambert's law.
    reasoning : what the estimate rests on.
    """

    name: str
    reflectance: tuple[float, float, float, float]
    spread: float
    brdf: Brdf
    reasoning: str
    origin: Literal["estimate"] = "estimate"

    def albedo(self, wavelength_nm: float, tint: float = 0.0) -> float:
        """Reflectance at a wavelength, linear between the catalogue's; `tint` −1 … 1 moves it within the spread.

        Raises `ValueError` outside 500 … 1600 nm, where nothing is known.
        """
        if not 500 <= wavelength_nm <= 1600:
            raise ValueError(f"wavelength {wavelength_nm:g} nm: the catalogue covers 500 … 1600 nm")
        middle = float(np.interp(wavelength_nm, WAVELENGTHS_NM, self.reflectance))
        return min(max(middle + tint * self.spread, 0.0), 1.0)


# fmt: off
_ROWS = (
    CatalogueMaterial("white_painted_plaster", (0.82, 0.84, 0.83, 0.68), 0.08, Brdf(specular=0.02, exponent=10.0),
        "Titanium-white wall paint looks 80–90 % bright and titania scatters alike through 1 µm; at 1550 nm the "
        "binder's and bound water's overtones and the longer wavelength take some away."),
    CatalogueMaterial("cream_wallpaper", (0.62, 0.70, 0.74, 0.60), 0.10, Brdf(),
        "Paper with a yellowish print: bright in red, lower in green; the pigment is clear in the near infrared; "
        "cellulose and its water absorb at 1550 nm."),
    CatalogueMaterial("grey_wall_paint", (0.45, 0.45, 0.44, 0.38), 0.15, Brdf(specular=0.02, exponent=10.0),
        "White paint darkened with a little carbon black, neutral over the whole range; binder loss at 1550 nm."),
    CatalogueMaterial("gypsum_board", (0.74, 0.77, 0.78, 0.56), 0.06, Brdf(),
        "Off-white paper facing over gypsum; gypsum's crystal water has strong bands near 1450–1550 nm."),
    CatalogueMaterial("mineral_ceiling_tile", (0.80, 0.82, 0.82, 0.70), 0.05, Brdf(),
        "Sold as about 80–90 % light-reflecting; white mineral fibre, latex paint, small binder loss at 1550 nm."),
    CatalogueMaterial("concrete", (0.30, 0.34, 0.37, 0.36), 0.10, Brdf(),
        "Dry grey concrete looks about a third as bright as white paper and slightly warm; cement hydrates hold some "
        "water, which flattens the rise at 1550 nm."),
    CatalogueMaterial("red_brick", (0.14, 0.32, 0.40, 0.46), 0.08, Brdf(),
        "Iron oxide absorbs green, lets red through, and has a weak band near 900 nm; fired clay is dry, so 1550 nm "
        "is brightest."),
    CatalogueMaterial("glazed_white_tile", (0.78, 0.80, 0.80, 0.74), 0.06, Brdf(specular=0.06, exponent=400.0),
        "White ceramic body under clear glaze: bright and dry; the glaze's Fresnel reflection of about 4 % is the "
        "specular part."),
    CatalogueMaterial("marble_floor", (0.60, 0.63, 0.65, 0.62), 0.15, Brdf(specular=0.06, exponent=200.0),
        "Polished light marble: carbonate grains scatter almost without absorption up to 1.5 µm, veins darken it."),
    CatalogueMaterial("grey_linoleum", (0.28, 0.33, 0.42, 0.36), 0.12, Brdf(specular=0.05, exponent=40.0),
        "Organic pigments in linseed binder: mid-grey to the eye, clearer in the near infrared, C–H overtones near "
        "1550 nm."),
    CatalogueMaterial("asphalt", (0.07, 0.08, 0.10, 0.13), 0.04, Brdf(),
        "Bitumen is near black at all these lines; worn road shows stone and brightens slowly with wavelength."),
    CatalogueMaterial("gravel", (0.24, 0.27, 0.30, 0.33), 0.10, Brdf(),
        "Mixed grey stone with shadows between the grains, rising slowly as dry minerals do."),
    CatalogueMaterial("dry_sand", (0.25, 0.35, 0.43, 0.49), 0.10, Brdf(),
        "Quartz with iron-stained coats: dark in green, rising steadily; dry, so no loss at 1550 nm."),
    CatalogueMaterial("dry_soil", (0.11, 0.18, 0.27, 0.36), 0.07, Brdf(),
        "Humus and iron oxides absorb the visible; soils brighten monotonically to 1.6 µm when dry."),
    CatalogueMaterial("fresh_snow", (0.93, 0.92, 0.82, 0.10), 0.06, Brdf(specular=0.02, exponent=20.0),
        "Ice hardly absorbs the visible and weakly at 905 nm, but strongly near 1500 nm, and turns dark there."),
    CatalogueMaterial("pine_wood", (0.44, 0.60, 0.68, 0.50), 0.08, Brdf(specular=0.02, exponent=15.0),
        "Light yellowish wood; lignin absorbs towards green; cellulose and about 10 % moisture absorb near 1500 nm."),
    CatalogueMaterial("dark_oak", (0.11, 0.20, 0.42, 0.42), 0.07, Brdf(specular=0.04, exponent=30.0),
        "Brown stain hides most of the visible but organic stains clear beyond 800 nm; moisture holds 1550 nm back."),
    CatalogueMaterial("plywood", (0.40, 0.54, 0.64, 0.48), 0.08, Brdf(),
        "As pine, slightly darker for the glue and the peeled grain."),
    CatalogueMaterial("cardboard", (0.28, 0.41, 0.56, 0.50), 0.07, Brdf(),
        "Unbleached kraft fibre: lignin brown in the visible, clear in the near infrared, cellulose loss at 1550."),
    CatalogueMaterial("white_paper", (0.80, 0.82, 0.83, 0.66), 0.05, Brdf(specular=0.01, exponent=10.0),
        "Office paper is about as bright as white paint; cellulose overtones and moisture at 1550 nm. Brighteners "
        "act below 500 nm and are left out."),
    CatalogueMaterial("white_cotton", (0.74, 0.77, 0.78, 0.55), 0.08, Brdf(),
        "Bleached cellulose fibre, a little translucent; moisture and cellulose absorb near 1500 nm."),
    CatalogueMaterial("blue_denim", (0.09, 0.08, 0.52, 0.46), 0.05, Brdf(),
        "Indigo absorbs green and most of all red, and is transparent beyond 750 nm, where the cotton shows."),
    CatalogueMaterial("black_cotton", (0.04, 0.05, 0.40, 0.38), 0.03, Brdf(),
        "Reactive black dyes cover the visible only, so black shirts often look grey in near-infrared cameras; cloth "
        "dyed with carbon would stay dark."),
    CatalogueMaterial("grey_wool_carpet", (0.17, 0.20, 0.42, 0.40), 0.10, Brdf(),
        "Dyed keratin fibre with deep shadows between the tufts; organic dye clear in the near infrared."),
    CatalogueMaterial("black_velvet", (0.01, 0.01, 0.06, 0.08), 0.01, Brdf(),
        "Pile that traps light: about one per cent to the eye; the dye loses strength in the infrared."),
    CatalogueMaterial("light_skin", (0.38, 0.58, 0.58, 0.08), 0.07, Brdf(specular=0.05, exponent=20.0),
        "Blood absorbs green, red passes; at 905 nm tissue scatters with little absorption; water makes skin nearly "
        "black at 1550 nm."),
    CatalogueMaterial("dark_skin", (0.09, 0.18, 0.42, 0.06), 0.05, Brdf(specular=0.08, exponent=20.0),
        "Melanin absorbs green most and fades towards the infrared; water as in any skin at 1550 nm."),
    CatalogueMaterial("green_foliage", (0.12, 0.05, 0.48, 0.25), 0.04, Brdf(specular=0.05, exponent=15.0),
        "Chlorophyll: weak minimum of absorption in green, maximum near 670 nm, none beyond 750 nm; leaf water "
        "absorbs around 1450 nm and its wing reaches 1550 nm."),
    CatalogueMaterial("dry_straw", (0.25, 0.36, 0.50, 0.45), 0.08, Brdf(),
        "Chlorophyll gone, lignin yellow left: rises through red to the infrared; dry cellulose near 1500 nm."),
    CatalogueMaterial("brushed_aluminium", (0.72, 0.71, 0.68, 0.82), 0.08, Brdf(specular=0.85, exponent=40.0),
        "Clean aluminium reflects about nine tenths, with an interband dip near 830 nm that reaches 905 nm; grooves "
        "and oxide cost about a fifth."),
    CatalogueMaterial("stainless_steel", (0.55, 0.58, 0.62, 0.70), 0.07, Brdf(specular=0.9, exponent=120.0),
        "Iron-chromium alloys reflect somewhat over half in the visible and rise slowly, as free-electron absorption "
        "falls."),
    CatalogueMaterial("galvanised_steel", (0.40, 0.43, 0.46, 0.52), 0.10, Brdf(specular=0.35, exponent=15.0),
        "Weathered zinc with a dull carbonate film: darker than bare metal and mostly diffuse."),
    CatalogueMaterial("tarnished_copper", (0.30, 0.60, 0.74, 0.85), 0.12, Brdf(specular=0.7, exponent=30.0),
        "Copper's interband edge lies near 580 nm: green is absorbed, red and infrared reflected; a thin oxide "
        "darkens the short end."),
    CatalogueMaterial("white_car_paint", (0.76, 0.79, 0.77, 0.62), 0.06, Brdf(specular=0.06, exponent=1000.0),
        "Titania base under clear coat: as white paint below, 4 % Fresnel gloss on top."),
    CatalogueMaterial("black_car_paint", (0.05, 0.05, 0.05, 0.05), 0.01, Brdf(specular=0.85, exponent=1000.0),
        "Carbon black absorbs everywhere; what is left is the clear coat's gloss of about 4 %."),
    CatalogueMaterial("white_plastic", (0.82, 0.85, 0.85, 0.64), 0.06, Brdf(specular=0.05, exponent=150.0),
        "Titania-filled ABS: bright to 1 µm, C–H overtones of the polymer near 1550 nm take part of it."),
    CatalogueMaterial("black_rubber", (0.04, 0.04, 0.04, 0.04), 0.02, Brdf(specular=0.1, exponent=10.0),
        "Filled with carbon black, which is neutral over the whole range."),
    CatalogueMaterial("matt_black_paint", (0.04, 0.04, 0.04, 0.05), 0.02, Brdf(),
        "Carbon black in a flat binder, made for the inside of instruments; the flatting agent shows a little at "
        "1550 nm."),
    CatalogueMaterial("diffuse_white_target", (0.98, 0.98, 0.98, 0.97), 0.01, Brdf(),
        "Sintered PTFE calibration targets are sold as about 99 % diffuse throughout; handling costs a little."),
    CatalogueMaterial("retroreflective_sign", (0.45, 0.48, 0.48, 0.40), 0.10, Brdf(0.03, 200.0, retro=0.6),
        "White sheeting looks mid-grey away from the source; glass beads or prisms send most of the rest straight "
        "back. The value is for all directions together."),
)
# fmt: on

MATERIALS: Mapping[str, CatalogueMaterial] = {row.name: row for row in _ROWS}
"""The catalogue by name."""
