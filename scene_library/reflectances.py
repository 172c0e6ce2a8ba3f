"""Reflectances that someone measured: samples of building materials, plants, soils and metals, with their sources.

A sample is hemispherical reflectance: all light that leaves the surface over all light that falls onto it. The
numbers are quoted from

- SLUM: Kotthaus, Smith, Wooster, Grimmond, ISPRS J. Photogramm. Remote Sens. 94, 194 (2014), doi
  10.5281/zenodo.4263842; only samples whose description is known;
- ECOSTRESS: ECOSTRESS spectral library, courtesy of the Jet Propulsion Laboratory (Meerdink, Hook, Roberts, Abbott,
  Remote Sens. Environ. 230, 111196 (2019));
- NASA: Spisz, Weigund, Bowmun, Juck, NASA TN D-5353 (1969), Table II a: polished metals at 294 K in an integrating
  sphere.

Samples of these libraries that are not used: SLUM samples without a description, whose letter gives the kind alone
(a brick, a metal); ECOSTRESS galvanized.steel.metal, darker (3 to 8 % up to 1064 nm) than any zinc coating one
meets; NASA titanium, whose 21 % at 532 nm are not the bare metal (n and k of Johnson & Christy (1974) give 58 %);
NASA molybdenum, platinum, tantalum and vanadium, which are no surfaces of rooms.

The samples named `Fresnel` are clean, smooth metals, by Fresnel's equations from published optical constants.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

WAVELENGTHS_NM = (532.0, 670.0, 850.0, 905.0, 940.0, 1064.0, 1550.0)
"""Laser lines, nm, that every reflectance is given for: green, red, and the usual ones of range sensors."""

Spectrum = tuple[float, ...]
"""A number at each of `WAVELENGTHS_NM`."""


@dataclass(frozen=True)
class Sample:
    """What was measured.

    Attributes
    ----------
    description : the sample in its library's words.
    reflectance : hemispherical reflectance at each of `WAVELENGTHS_NM`, 0 … 1.
    """

    description: str
    reflectance: Spectrum


@dataclass(frozen=True)
class OpticalConstants:
    """Refractive index n + i k of a metal, between the lines of a published table linear in the wavelength.

    Attributes
    ----------
    source : who measured it.
    n, k : real and imaginary part at each of `WAVELENGTHS_NM`.
    """

    source: str
    n: Spectrum
    k: Spectrum

    def reflectance(self) -> Spectrum:
        """Share of light that a clean, smooth surface in air reflects at normal incidence, at each wavelength.

        Fresnel's equations: R = ((n − 1)² + k²) / ((n + 1)² + k²).
        """
        return tuple(((n - 1) ** 2 + k**2) / ((n + 1) ** 2 + k**2) for n, k in zip(self.n, self.k, strict=True))


_NOBLE = "Johnson & Christy, Phys. Rev. B 6, 4370 (1972)"

# fmt: off
OPTICAL_CONSTANTS: Mapping[str, OpticalConstants] = {
    "Al": OpticalConstants("Rakić, Appl. Opt. 34, 4755 (1995)",
        (0.939, 1.698, 2.588, 2.052, 1.674, 1.376, 1.579), (6.420, 7.893, 8.169, 8.257, 8.608, 10.245, 15.658)),
    "Cu": OpticalConstants(_NOBLE,
        (1.116, 0.218, 0.276, 0.303, 0.310, 0.351, 0.716), (2.596, 3.854, 5.420, 5.860, 6.109, 7.033, 10.655)),
    "Au": OpticalConstants(_NOBLE,
        (0.544, 0.138, 0.164, 0.177, 0.196, 0.258, 0.524), (2.231, 3.792, 5.319, 5.760, 6.021, 6.965, 10.742)),
    "Ag": OpticalConstants(_NOBLE,
        (0.054, 0.048, 0.040, 0.040, 0.040, 0.040, 0.144), (3.429, 4.566, 5.965, 6.408, 6.667, 7.610, 11.366)),
    "Ni": OpticalConstants("Johnson & Christy, Phys. Rev. B 9, 5056 (1974)",
        (1.878, 2.007, 2.317, 2.411, 2.442, 2.611, 3.090), (3.495, 4.319, 5.076, 5.275, 5.397, 5.842, 7.717)),
}
"""Chemical symbol → optical constants of that metal."""

SAMPLES: Mapping[str, Sample] = {
    "SLUM A001": Sample("asphalt with stones", (0.187, 0.223, 0.240, 0.242, 0.244, 0.246, 0.258)),
    "SLUM A007": Sample("roofing felt", (0.067, 0.071, 0.074, 0.073, 0.073, 0.070, 0.063)),
    "SLUM A008": Sample("black tarmac", (0.123, 0.135, 0.140, 0.141, 0.142, 0.141, 0.146)),
    "SLUM B001": Sample("brick, yellow cement", (0.241, 0.334, 0.336, 0.329, 0.330, 0.341, 0.372)),
    "SLUM B008": Sample("brick, light red, new", (0.203, 0.440, 0.476, 0.483, 0.502, 0.609, 0.688)),
    "SLUM B012": Sample("brick, painted", (0.480, 0.606, 0.633, 0.634, 0.637, 0.658, 0.619)),
    "SLUM B013": Sample("brick, red clay, weathered", (0.175, 0.315, 0.370, 0.379, 0.393, 0.446, 0.494)),
    "SLUM C001": Sample("cement, weathered, ochre", (0.232, 0.309, 0.328, 0.324, 0.325, 0.341, 0.346)),
    "SLUM C002": Sample("concrete, new, grey-white", (0.173, 0.218, 0.224, 0.223, 0.224, 0.232, 0.263)),
    "SLUM C004": Sample("concrete, weathered, grey", (0.362, 0.390, 0.394, 0.391, 0.392, 0.393, 0.393)),
    "SLUM C006": Sample("concrete, white", (0.358, 0.439, 0.471, 0.474, 0.477, 0.492, 0.509)),
    "SLUM G001": Sample("granite, rough", (0.450, 0.494, 0.515, 0.516, 0.517, 0.512, 0.503)),
    "SLUM R001": Sample("ceramic roof tile, red, new", (0.120, 0.336, 0.380, 0.379, 0.389, 0.435, 0.444)),
    "SLUM R007": Sample("ceramic roof tile, black", (0.074, 0.080, 0.119, 0.131, 0.141, 0.214, 0.476)),
    "SLUM R010": Sample("ceramic roof tile, weathered", (0.100, 0.174, 0.221, 0.228, 0.235, 0.269, 0.324)),
    "SLUM S001": Sample("sandstone", (0.339, 0.423, 0.439, 0.432, 0.435, 0.446, 0.553)),
    "SLUM V001": Sample("PVC, dark", (0.091, 0.082, 0.073, 0.071, 0.071, 0.069, 0.059)),
    "SLUM V002": Sample("PVC, light grey", (0.474, 0.467, 0.452, 0.447, 0.445, 0.435, 0.381)),
    "SLUM V004": Sample("PVC, blue", (0.119, 0.062, 0.194, 0.202, 0.202, 0.197, 0.169)),
    "SLUM Z003": Sample("metal, painted green", (0.088, 0.083, 0.106, 0.127, 0.148, 0.175, 0.210)),
    "SLUM Z004": Sample("copper, patina", (0.471, 0.318, 0.646, 0.653, 0.656, 0.633, 0.257)),
    "SLUM Z005": Sample("metal, painted grey", (0.127, 0.106, 0.102, 0.119, 0.139, 0.157, 0.174)),
    "SLUM Z006": Sample("aluminium sheet, weathered", (0.283, 0.278, 0.238, 0.222, 0.212, 0.200, 0.279)),
    "SLUM Z008": Sample("iron, weathered, black", (0.050, 0.053, 0.056, 0.056, 0.057, 0.059, 0.065)),
    "ECOSTRESS construction.asphalt": Sample("asphalt", (0.069, 0.092, 0.110, 0.114, 0.117, 0.125, 0.150)),
    "ECOSTRESS construction.concrete.": Sample("concrete, construction",
        (0.320, 0.363, 0.364, 0.359, 0.356, 0.346, 0.334)),
    "ECOSTRESS aluminum.metal": Sample("aluminium, used", (0.491, 0.531, 0.538, 0.596, 0.628, 0.709, 0.813)),
    "ECOSTRESS light.yellowish.brown.clay": Sample("soil, light clay",
        (0.349, 0.469, 0.506, 0.495, 0.497, 0.511, 0.596)),
    "ECOSTRESS black.loam": Sample("soil, black loam", (0.041, 0.091, 0.169, 0.185, 0.198, 0.239, 0.327)),
    "ECOSTRESS dry.grass": Sample("grass, dry", (0.284, 0.426, 0.565, 0.598, 0.618, 0.648, 0.568)),
    "ECOSTRESS grass": Sample("grass", (0.096, 0.045, 0.497, 0.509, 0.507, 0.525, 0.243)),
    "ECOSTRESS conifer": Sample("leaves, conifer", (0.102, 0.041, 0.515, 0.515, 0.504, 0.524, 0.188)),
    "ECOSTRESS decidous": Sample("leaves, deciduous", (0.103, 0.048, 0.549, 0.554, 0.548, 0.569, 0.253)),
    "ECOSTRESS fine.snow": Sample("snow, fine", (0.991, 0.977, 0.938, 0.911, 0.901, 0.829, 0.110)),
    "NASA aluminum": Sample("aluminium, polished", (0.864, 0.877, 0.836, 0.877, 0.897, 0.946, 0.987)),
    "NASA copper": Sample("copper, polished", (0.459, 0.846, 0.918, 0.928, 0.945, 0.954, 0.990)),
    "NASA gold": Sample("gold, polished", (0.712, 0.934, 0.974, 0.980, 0.982, 0.989, 0.996)),
    "NASA nickel": Sample("nickel, polished", (0.561, 0.629, 0.678, 0.685, 0.679, 0.709, 0.845)),
    "NASA silver": Sample("silver, polished", (0.896, 0.963, 0.978, 0.979, 0.988, 0.990, 1.000)),
    "NASA tin": Sample("tin, polished", (0.820, 0.837, 0.831, 0.829, 0.834, 0.818, 0.898)),
    "NASA stainless steel": Sample("stainless steel, polished", (0.600, 0.641, 0.677, 0.674, 0.682, 0.700, 0.810)),
    **{f"Fresnel {metal}": Sample(f"clean and smooth; n, k of {of.source}", of.reflectance())
       for metal, of in OPTICAL_CONSTANTS.items()},
}
"""Source and number of a sample → the sample."""
# fmt: on
