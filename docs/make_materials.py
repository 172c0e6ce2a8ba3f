"""Writes docs/materials.md, the table of the material catalogue: `make generated`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from scene_library.materials import MATERIALS, CatalogueMaterial
from scene_library.reflectances import WAVELENGTHS_NM

PAGE = Path(__file__).with_name("materials.md")
INTRODUCTION = """\
# Materials

For everyone who names materials in a configuration. `make generated` makes this page of `scene_library/materials.py`.

A material's albedo is its hemispherical reflectance at `scene.wavelength_nm`: the mean below, moved by a random tint
that is uniform within ± the spread (narrowed where it would pass 0 or 100 %). Between the listed wavelengths both are
linear, which misses what lies between them: the red edge of leaves near 700 nm, and the bands of water near 970 and
1450 nm. Other wavelengths than 532 to 1550 nm are refused. The lobes (`brdf: {kind: catalogue}`) are estimates for
every material, the same at every wavelength. Reflectances and spreads are in percent, wavelengths in nm.
"""
MEASURED = """\
## Measured

The mean of one to three samples, which `scene_library/materials.py` names for each material. The spread is half of
their range where there are several, and an estimate for a single one. Sources: SLUM, Kotthaus et al., ISPRS J. 94,
194 (2014), doi 10.5281/zenodo.4263842; ECOSTRESS spectral library, courtesy of the Jet Propulsion Laboratory; NASA
TN D-5353 (1969); for five polished metals also Fresnel's equations with published optical constants.
"""
ESTIMATED = """\
## Estimated

No sample of these materials was at hand. `scene_library/materials.py` says what each estimate rests on.
"""


def page() -> str:
    """The whole page."""
    rows = MATERIALS.values()
    measured = _table([row for row in rows if row.origin == "measured"])
    estimated = _table([row for row in rows if row.origin == "estimate"])
    return "\n".join([INTRODUCTION, MEASURED, *measured, "", ESTIMATED, *estimated, ""])


def _table(rows: list[CatalogueMaterial]) -> Iterator[str]:
    heads = ["`material`", *(f"{wavelength:g}" for wavelength in WAVELENGTHS_NM), "spread"]
    yield f"| {' | '.join(heads)} |"
    yield f"|---|{'---:|' * (len(WAVELENGTHS_NM) + 1)}"
    for row in rows:
        low, high = (f"{100 * share:.0f}" for share in (min(row.spread), max(row.spread)))
        spread = low if low == high else f"{low}–{high}"
        cells = [f"`{row.name}`", *(f"{100 * value:.0f}" for value in row.reflectance), spread]
        yield f"| {' | '.join(cells)} |"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
