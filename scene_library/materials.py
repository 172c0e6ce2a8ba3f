"""A catalogue of real materials: reflectance at the usual laser lines, and how they depart from Lambert's law.

Reflectances are `measured` where a sample of `scene_library.reflectances` is that very material, and `estimate`
everywhere else; `reasoning` says why, or what the estimate rests on. The departures from Lambert's law are estimates
throughout.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from scene_library.reflectances import SAMPLES, WAVELENGTHS_NM, Spectrum


@dataclass(frozen=True)
class Brdf:
    """Departure from a Lambertian surface, all estimates, the same at every wavelength.

    Attributes
    ----------
    specular : share of the reflected light that is scattered around the mirror direction at normal incidence, 0 … 1.
    exponent : Phong exponent of that lobe (about 2/roughness² − 2); 0 where there is no lobe.
    retro : share that goes back towards the source, 0 … 1.
    """

    specular: float = 0.0
    exponent: float = 0.0
    retro: float = 0.0


@dataclass(frozen=True)
class CatalogueMaterial:
    """One material.

    Attributes
    ----------
    reflectance : hemispherical reflectance at each of `WAVELENGTHS_NM`, 0 … 1; the mean of `samples` if it has any.
    spread : half-width of the range of reflectances met under this name (colour, wear, dirt) at each of
        `WAVELENGTHS_NM`. It is half of the range of `samples` if there are several, and otherwise an estimate.
    brdf : how it departs from Lambert's law.
    reasoning : why the samples stand for the material, or what the estimate rests on.
    samples : keys of `SAMPLES` that the reflectance was taken from; none for an estimate.
    """

    name: str
    reflectance: Spectrum
    spread: Spectrum
    brdf: Brdf
    reasoning: str
    samples: tuple[str, ...] = ()

    @property
    def origin(self) -> Literal["measured", "estimate"]:
        """Whether the reflectance was measured, or estimated."""
        return "measured" if self.samples else "estimate"

    def albedo(self, wavelength_nm: float, tint: float = 0.0) -> float:
        """Reflectance at a wavelength, linear between the catalogue's; `tint` −1 … 1 moves it within the spread.

        The spread is narrowed where it would reach below 0 or above 1, on both sides alike, so that the mean stays.
        Raises `ValueError` outside 532 … 1550 nm.
        """
        at = checked_wavelength_nm(wavelength_nm)
        middle = float(np.interp(at, WAVELENGTHS_NM, self.reflectance))
        spread = min(float(np.interp(at, WAVELENGTHS_NM, self.spread)), middle, 1 - middle)
        return min(max(middle + tint * spread, 0.0), 1.0)


def checked_wavelength_nm(wavelength_nm: float) -> float:
    """The wavelength itself. Raises `ValueError` if it lies outside the catalogue's range, 532 … 1550 nm."""
    low, high = WAVELENGTHS_NM[0], WAVELENGTHS_NM[-1]
    if not low <= wavelength_nm <= high:
        raise ValueError(
            f"{wavelength_nm:g} nm given, and the catalogue of materials covers {low:g} … {high:g} nm; take a "
            "wavelength in that range, or leave the key out and give every surface an albedo in place of a material"
        )
    return wavelength_nm


def _estimate(name: str, reflectance: Spectrum, spread: float, brdf: Brdf, reasoning: str) -> CatalogueMaterial:
    """A material nobody measured for us, with the same spread at every wavelength."""
    return CatalogueMaterial(name, reflectance, _everywhere(spread), brdf, reasoning)


def _measured_material(
    name: str, samples: tuple[str, ...], brdf: Brdf, reasoning: str, spread: float | None = None
) -> CatalogueMaterial:
    """The mean of the samples; their range gives the spread, or, for a single sample, an estimate: `spread`."""
    spectra = [SAMPLES[sample].reflectance for sample in samples]
    mean = tuple(sum(values) / len(values) for values in zip(*spectra, strict=True))
    half = tuple((max(values) - min(values)) / 2 for values in zip(*spectra, strict=True))
    return CatalogueMaterial(name, mean, half if spread is None else _everywhere(spread), brdf, reasoning, samples)


def _everywhere(value: float) -> Spectrum:
    return (value,) * len(WAVELENGTHS_NM)


# fmt: off
_ROWS = (
    _estimate("white_painted_plaster", (0.82, 0.84, 0.84, 0.83, 0.83, 0.82, 0.68), 0.08,
        Brdf(specular=0.02, exponent=10.0),
        "Titanium-white wall paint looks 80–90 % bright and titania scatters alike through 1 µm; at 1550 nm the "
        "binder's and bound water's overtones and the longer wavelength take some away."),
    _estimate("cream_wallpaper", (0.62, 0.70, 0.74, 0.74, 0.74, 0.73, 0.60), 0.10, Brdf(),
        "Paper with a yellowish print: bright in red, lower in green; the pigment is clear in the near infrared; "
        "cellulose and its water absorb at 1550 nm."),
    _estimate("grey_wall_paint", (0.45, 0.45, 0.44, 0.44, 0.44, 0.43, 0.38), 0.15, Brdf(specular=0.02, exponent=10.0),
        "White paint darkened with a little carbon black, neutral over the whole range; binder loss at 1550 nm."),
    _estimate("gypsum_board", (0.74, 0.77, 0.78, 0.78, 0.78, 0.77, 0.56), 0.06, Brdf(),
        "Off-white paper facing over gypsum; gypsum's crystal water has strong bands near 1450–1550 nm."),
    _estimate("mineral_ceiling_tile", (0.80, 0.82, 0.82, 0.82, 0.82, 0.81, 0.70), 0.05, Brdf(),
        "Sold as about 80–90 % light-reflecting; white mineral fibre, latex paint, small binder loss at 1550 nm."),
    _measured_material("concrete", ("SLUM C002", "SLUM C004", "ECOSTRESS construction.concrete."), Brdf(),
        "Grey construction concrete: new, weathered, and one of unknown age. White and ochre concrete have their "
        "own rows."),
    _measured_material("red_brick", ("SLUM B008", "SLUM B013"), Brdf(),
        "Red clay bricks, one new and one weathered: iron oxide absorbs green, and fired clay is dry at 1550 nm."),
    _estimate("glazed_white_tile", (0.78, 0.80, 0.80, 0.80, 0.80, 0.80, 0.74), 0.06,
        Brdf(specular=0.06, exponent=400.0),
        "White ceramic body under clear glaze: bright and dry; the glaze's Fresnel reflection of about 4 % is the "
        "specular part."),
    _estimate("marble_floor", (0.60, 0.63, 0.65, 0.65, 0.65, 0.65, 0.62), 0.15, Brdf(specular=0.06, exponent=200.0),
        "Polished light marble: carbonate grains scatter almost without absorption up to 1.5 µm, veins darken it."),
    _estimate("grey_linoleum", (0.28, 0.33, 0.41, 0.42, 0.43, 0.44, 0.36), 0.12, Brdf(specular=0.05, exponent=40.0),
        "Organic pigments in linseed binder: mid-grey to the eye, clearer in the near infrared, C–H overtones near "
        "1550 nm."),
    _measured_material("asphalt", ("SLUM A001", "SLUM A008", "ECOSTRESS construction.asphalt"), Brdf(),
        "Road surfaces from black tarmac to asphalt with visible stones."),
    _estimate("gravel", (0.24, 0.27, 0.29, 0.30, 0.30, 0.31, 0.33), 0.10, Brdf(),
        "Mixed grey stone with shadows between the grains, rising slowly as dry minerals do."),
    _estimate("dry_sand", (0.25, 0.35, 0.42, 0.43, 0.43, 0.45, 0.49), 0.10, Brdf(),
        "Quartz with iron-stained coats: dark in green, rising steadily; dry, so no loss at 1550 nm."),
    _measured_material("dry_soil", ("ECOSTRESS light.yellowish.brown.clay", "ECOSTRESS black.loam"), Brdf(),
        "From a light clay to a black loam: soils lie between the two. Both rise up to 1550 nm, so they were dry."),
    _measured_material("fresh_snow", ("ECOSTRESS fine.snow",), Brdf(specular=0.02, exponent=20.0),
        "Clean fine-grained snow, as it falls; coarser or dirty snow is darker. Ice absorbs near 1500 nm.",
        spread=0.06),
    _estimate("pine_wood", (0.44, 0.60, 0.67, 0.68, 0.68, 0.69, 0.50), 0.08, Brdf(specular=0.02, exponent=15.0),
        "Light yellowish wood; lignin absorbs towards green; cellulose and about 10 % moisture absorb near 1500 nm."),
    _estimate("dark_oak", (0.11, 0.20, 0.38, 0.42, 0.44, 0.49, 0.42), 0.07, Brdf(specular=0.04, exponent=30.0),
        "Brown stain hides most of the visible but organic stains clear beyond 800 nm; moisture holds 1550 nm back."),
    _estimate("plywood", (0.40, 0.54, 0.63, 0.64, 0.64, 0.65, 0.48), 0.08, Brdf(),
        "As pine, slightly darker for the glue and the peeled grain."),
    _estimate("cardboard", (0.28, 0.41, 0.54, 0.56, 0.57, 0.59, 0.50), 0.07, Brdf(),
        "Unbleached kraft fibre: lignin brown in the visible, clear in the near infrared, cellulose loss at 1550."),
    _estimate("white_paper", (0.80, 0.82, 0.83, 0.83, 0.83, 0.82, 0.66), 0.05, Brdf(specular=0.01, exponent=10.0),
        "Office paper is about as bright as white paint; cellulose overtones and moisture at 1550 nm. Brighteners "
        "act below 500 nm and are left out."),
    _estimate("white_cotton", (0.74, 0.77, 0.78, 0.78, 0.78, 0.77, 0.55), 0.08, Brdf(),
        "Bleached cellulose fibre, a little translucent; moisture and cellulose absorb near 1500 nm."),
    _estimate("blue_denim", (0.09, 0.08, 0.50, 0.52, 0.53, 0.54, 0.46), 0.05, Brdf(),
        "Indigo absorbs green and most of all red, and is transparent beyond 750 nm, where the cotton shows."),
    _estimate("black_cotton", (0.04, 0.05, 0.36, 0.40, 0.42, 0.46, 0.38), 0.03, Brdf(),
        "Reactive black dyes cover the visible only, so black shirts often look grey in near-infrared cameras; cloth "
        "dyed with carbon would stay dark."),
    _estimate("grey_wool_carpet", (0.17, 0.20, 0.39, 0.42, 0.43, 0.46, 0.40), 0.10, Brdf(),
        "Dyed keratin fibre with deep shadows between the tufts; organic dye clear in the near infrared."),
    _estimate("black_velvet", (0.01, 0.01, 0.05, 0.06, 0.06, 0.08, 0.08), 0.01, Brdf(),
        "Pile that traps light: about one per cent to the eye; the dye loses strength in the infrared."),
    _estimate("light_skin", (0.38, 0.58, 0.60, 0.58, 0.55, 0.53, 0.08), 0.07, Brdf(specular=0.05, exponent=20.0),
        "Blood absorbs green, red passes; from 850 to 905 nm tissue scatters with little absorption; a weak band of "
        "water at 970 nm reaches 940 nm; water makes skin nearly black at 1550 nm."),
    _estimate("dark_skin", (0.09, 0.18, 0.38, 0.42, 0.42, 0.44, 0.06), 0.05, Brdf(specular=0.08, exponent=20.0),
        "Melanin absorbs green most and fades towards the infrared; water as in any skin at 1550 nm."),
    _measured_material("green_foliage", ("ECOSTRESS decidous",), Brdf(specular=0.05, exponent=15.0),
        "Green leaves of deciduous trees. Chlorophyll absorbs up to 700 nm, leaf water at 1550 nm.", spread=0.04),
    _measured_material("dry_straw", ("ECOSTRESS dry.grass",), Brdf(),
        "Dry grass, of which straw is the stalks: no chlorophyll is left, lignin absorbs green.", spread=0.08),
    _estimate("brushed_aluminium", (0.73, 0.72, 0.70, 0.72, 0.73, 0.76, 0.78), 0.08,
        Brdf(specular=0.85, exponent=40.0),
        "Four fifths of what Fresnel's equations give for clean aluminium, with its interband dip near 830 nm: "
        "grooves and oxide cost about a fifth. Used and weathered sheet, which were measured, are not brushed."),
    _measured_material("stainless_steel", ("NASA stainless steel",), Brdf(specular=0.9, exponent=120.0),
        "Polished stainless steel; its lobe is that of a satin finish.", spread=0.07),
    _estimate("galvanised_steel", (0.40, 0.40, 0.36, 0.34, 0.33, 0.33, 0.52), 0.10,
        Brdf(specular=0.35, exponent=15.0),
        "Weathered zinc with a dull carbonate film: darker than bare metal and mostly diffuse; zinc's interband "
        "absorption near 1 µm shows through. The sample at hand is too dark to be one."),
    _estimate("tarnished_copper", (0.30, 0.60, 0.72, 0.74, 0.75, 0.78, 0.85), 0.12, Brdf(specular=0.7, exponent=30.0),
        "Copper's interband edge lies near 580 nm: green is absorbed, red and infrared reflected; a thin oxide "
        "darkens the short end. Polished copper and green patina, which were measured, are its two ends."),
    _estimate("white_car_paint", (0.76, 0.79, 0.78, 0.77, 0.77, 0.76, 0.62), 0.06,
        Brdf(specular=0.06, exponent=1000.0),
        "Titania base under clear coat: as white paint below, 4 % Fresnel gloss on top."),
    _estimate("black_car_paint", (0.05, 0.05, 0.05, 0.05, 0.05, 0.05, 0.05), 0.01,
        Brdf(specular=0.85, exponent=1000.0),
        "Carbon black absorbs everywhere; what is left is the clear coat's gloss of about 4 %."),
    _estimate("white_plastic", (0.82, 0.85, 0.85, 0.85, 0.85, 0.84, 0.64), 0.06, Brdf(specular=0.05, exponent=150.0),
        "Titania-filled ABS: bright to 1 µm, C–H overtones of the polymer near 1550 nm take part of it."),
    _estimate("black_rubber", (0.04, 0.04, 0.04, 0.04, 0.04, 0.04, 0.04), 0.02, Brdf(specular=0.1, exponent=10.0),
        "Filled with carbon black, which is neutral over the whole range."),
    _estimate("matt_black_paint", (0.04, 0.04, 0.04, 0.04, 0.04, 0.04, 0.05), 0.02, Brdf(),
        "Carbon black in a flat binder, made for the inside of instruments; the flatting agent shows a little at "
        "1550 nm."),
    _estimate("diffuse_white_target", (0.98, 0.98, 0.98, 0.98, 0.98, 0.98, 0.97), 0.01, Brdf(),
        "Sintered PTFE calibration targets are sold as about 99 % diffuse throughout; handling costs a little."),
    _estimate("retroreflective_sign", (0.45, 0.48, 0.48, 0.48, 0.48, 0.47, 0.40), 0.10, Brdf(0.03, 200.0, retro=0.6),
        "White sheeting looks mid-grey away from the source; glass beads or prisms send most of the rest straight "
        "back. The value is for all directions together."),
    _measured_material("roofing_felt", ("SLUM A007",), Brdf(),
        "Bitumen sheet, as the library calls it.", spread=0.02),
    _measured_material("white_concrete", ("SLUM C006",), Brdf(),
        "Concrete of white cement.", spread=0.06),
    _measured_material("ochre_cement", ("SLUM C001",), Brdf(),
        "Weathered cement, coloured by iron oxide.", spread=0.06),
    _measured_material("yellow_brick", ("SLUM B001",), Brdf(),
        "A yellow cement brick, not a clay one.", spread=0.06),
    _measured_material("painted_brick", ("SLUM B012",), Brdf(specular=0.02, exponent=10.0),
        "Light paint over brick, its colour not stated; the spectrum is warm white.", spread=0.08),
    _measured_material("granite", ("SLUM G001",), Brdf(),
        "Granite with a rough surface; polished slabs are darker and glossy.", spread=0.08),
    _measured_material("sandstone", ("SLUM S001",), Brdf(),
        "A light sandstone; the library's other stones of that kind go from 0.19 to 0.57 at 532 nm.", spread=0.12),
    _measured_material("red_roof_tile", ("SLUM R001",), Brdf(),
        "New red ceramic tile, iron oxide as in brick.", spread=0.06),
    _measured_material("black_roof_tile", ("SLUM R007",), Brdf(),
        "Black ceramic tile: its pigment clears beyond 1000 nm.", spread=0.03),
    _measured_material("weathered_roof_tile", ("SLUM R010",), Brdf(),
        "Ceramic tile that has weathered on a roof.", spread=0.04),
    _measured_material("dark_pvc", ("SLUM V001",), Brdf(specular=0.3, exponent=50.0),
        "Dark plastic sheet; gloss is a large part of the little that it returns.", spread=0.02),
    _measured_material("light_grey_pvc", ("SLUM V002",), Brdf(specular=0.06, exponent=50.0),
        "Light grey plastic sheet.", spread=0.06),
    _measured_material("blue_pvc", ("SLUM V004",), Brdf(specular=0.2, exponent=50.0),
        "Blue plastic sheet: its dye absorbs red and clears before 850 nm.", spread=0.03),
    _measured_material("green_painted_metal", ("SLUM Z003",), Brdf(specular=0.3, exponent=50.0),
        "Sheet metal under green paint.", spread=0.03),
    _measured_material("grey_painted_metal", ("SLUM Z005",), Brdf(specular=0.3, exponent=50.0),
        "Sheet metal under grey paint.", spread=0.04),
    _measured_material("copper_patina", ("SLUM Z004",), Brdf(),
        "Green patina on copper: copper salts absorb red, and their water 1550 nm.", spread=0.06),
    _measured_material("weathered_aluminium", ("SLUM Z006",), Brdf(specular=0.4, exponent=15.0),
        "Aluminium sheet that has been outdoors for long.", spread=0.05),
    _measured_material("used_aluminium", ("ECOSTRESS aluminum.metal",), Brdf(specular=0.7, exponent=30.0),
        "Aluminium that has been in use, between weathered and polished sheet.", spread=0.08),
    _measured_material("weathered_iron", ("SLUM Z008",), Brdf(specular=0.2, exponent=10.0),
        "Iron with a black skin of oxide.", spread=0.02),
    _measured_material("light_clay_soil", ("ECOSTRESS light.yellowish.brown.clay",), Brdf(),
        "Light yellowish brown clay, dry.", spread=0.06),
    _measured_material("black_loam_soil", ("ECOSTRESS black.loam",), Brdf(),
        "Black loam, dry: humus absorbs less and less towards the infrared.", spread=0.03),
    _measured_material("green_grass", ("ECOSTRESS grass",), Brdf(specular=0.03, exponent=15.0),
        "Green grass: chlorophyll and water as in leaves.", spread=0.03),
    _measured_material("conifer_leaves", ("ECOSTRESS conifer",), Brdf(specular=0.03, exponent=15.0),
        "Green needles of conifers, darker than leaves at 1550 nm, where water absorbs.", spread=0.03),
    _measured_material("polished_aluminium", ("Fresnel Al", "NASA aluminum"), Brdf(specular=0.95, exponent=1000.0),
        "Between a clean, smooth surface and a polished sheet in an integrating sphere. Interband absorption near "
        "830 nm."),
    _measured_material("polished_copper", ("Fresnel Cu", "NASA copper"), Brdf(specular=0.95, exponent=1000.0),
        "Between a clean, smooth surface and a polished sheet in an integrating sphere. Interband absorption below "
        "580 nm."),
    _measured_material("polished_gold", ("Fresnel Au", "NASA gold"), Brdf(specular=0.95, exponent=1000.0),
        "Between a clean, smooth surface and a polished sheet in an integrating sphere. Interband absorption below "
        "520 nm."),
    _measured_material("polished_silver", ("Fresnel Ag", "NASA silver"), Brdf(specular=0.95, exponent=1000.0),
        "Between a clean, smooth surface and a polished sheet in an integrating sphere. No interband absorption in "
        "this range."),
    _measured_material("polished_nickel", ("Fresnel Ni", "NASA nickel"), Brdf(specular=0.95, exponent=1000.0),
        "Between a clean, smooth surface and a polished sheet in an integrating sphere. Interband absorption "
        "throughout."),
    _measured_material("polished_tin", ("NASA tin",), Brdf(specular=0.95, exponent=1000.0),
        "Polished tin; tinplate shows it.", spread=0.04),
)
# fmt: on

MATERIALS: Mapping[str, CatalogueMaterial] = {row.name: row for row in _ROWS}
"""The catalogue by name."""
