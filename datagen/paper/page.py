"""The page: what of the paper holds, its figures, times and levels, and what had to be chosen."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from html import escape

from datagen.paper.as_printed import AsPrinted
from datagen.paper.envelope_figures import sigma_ps
from datagen.paper.measures import PEAKS_NS, SECONDS, SIGMA_PS
from datagen.paper.room_samples import FromLookin, Lit
from datagen.paper.runs import CONSERVED, GRIDS, SCHEMES, Estimator, Runs, Simulation
from datagen.paper.statements import Statement, Verdict, ratio
from datagen.report.html import head, table
from datagen.store.environment import processor

_UNDEFINED = re.compile(r"[+-]?\bnan\b")
_ESTIMATORS: tuple[Estimator, ...] = ("as printed", "radiometric")

CHOICES = (
    ("grid of rays",
     "“a 10 × 10 grid of rays”, θ over 2π, φ over 0 … π/2 (sec. 3.1, Fig. 2b): taken as equal steps of both angles; "
     "<code>AsPrinted(grid=\"solid_angle\")</code> takes equal solid angles"),
    ("half cube map",
     "a camera of 180° with 60 × 60 pixels: a face of 90° with 30 × 30 and four half faces with 30 × 15 pixels. "
     "Unfolded they fill a cross in the 60 × 60 picture; its corners, 900 places, hold no direction, so Ñ is 2700 "
     "and not 3600"),
    ("α", "“a normalization constant, to ensure the conservation of energy”: 1/Σ B over the directions sampled"),
    ("α₁ in Eq. 8",
     "the same, over all lit observed points of all lookins; <code>conserved=\"lookin\"</code> (the set k runs over) "
     "and <code>\"rays\"</code> (the α₁ of Eq. 6) are the other readings"),
    ("β",
     "“a modified normalization that accounts for the single input and output vectors”: a single direction has no "
     "sum, so 1/∫ B dω over the hemisphere: 1/π for cosφ, 1/4 for |sinθ|"),
    ("C_atm", "a transmission per unit length, raised to the length; 1 here as in the paper"),
    ("field of view",
     "an observed point is in it if the sensor sees it: within the square's cone, facing, not hidden"),
    ("the room",
     "no plan was published, and the peaks do not fix one: all sizes are ours, laid out so that radiometric weights "
     "have the published peaks. With a ceiling of 3.00 m for 2.88 m, a box of 2.2 m for 2.6 m and the pillar a "
     "little further in the printed weights have them. The paper's frame is left-handed, ours right-handed"),
)  # fmt: skip


def page(
    runs: Runs,
    statements: Sequence[Statement],
    points: Lit,
    examples: Sequence[FromLookin],
    images: Mapping[str, str],
    command: str,
) -> Iterator[str]:
    """The page's HTML, piece by piece. images : number of the paper's figure → file beside the page."""
    yield head("What of the paper holds")
    yield (
        "<p>Scholes &amp; Leach, <i>Path Tracing-Inspired Modeling of Non-Line-of-Sight SPAD Data</i>, Sensors "
        "24(20), 6522 (2024), computed again twice: <b>as printed</b>, by its Eq. 6 and Eq. 8 to the letter with "
        "lengths in millimetres, and with <b>radiometric</b> weights. "
        f"Room: <code>{escape(runs.config.name)}</code>. Every verdict below comes from this run's own numbers, all "
        "of them in <code>numbers.json</code>. Made by "
        f"<code>{escape(command)}</code> on one core of {escape(processor())}.</p>"
    )
    yield _summary(statements)
    yield "<h2>Point by point</h2>"
    rows = [
        (f"{escape(s.claim)}<br><small>{escape(s.source)}</small>", _verdict(s.printed), _verdict(s.radiometric))
        for s in statements
    ]
    yield table(("what the paper says", "as printed", "radiometric"), rows)
    for number, text in _deviations(runs, points, examples).items():
        yield f"<h2>Fig. {number}</h2>{text}"
        yield f'<p><img alt="Fig. {number} of the paper, computed again" src="{images[number]}"></p>'
    yield from times(runs)
    yield from _levels(runs)
    yield "<h2>What the text leaves open, and what was taken</h2>"
    yield table(("", "taken here"), CHOICES)
    yield "</body></html>"


def _summary(statements: Sequence[Statement]) -> str:
    def count(kind: str) -> str:
        verdicts = [getattr(s, kind) for s in statements]
        decided = [v.holds for v in verdicts if v.holds is not None]
        return f"{sum(decided)} of {len(decided)}"

    gone = [s.claim for s in statements if s.printed.holds and s.radiometric.holds is False]
    won = [s.claim for s in statements if s.printed.holds is False and s.radiometric.holds]
    text = (
        f"<p>Of the statements that this room can decide, {count('printed')} hold as printed and "
        f"{count('radiometric')} with correct radiometry.</p>"
    )
    for claims, one, other in ((gone, "as printed", "with correct radiometry"),
                               (won, "with correct radiometry", "as printed")):  # fmt: skip
        if claims:
            listed = "".join(f"<li>{escape(claim)}</li>" for claim in claims)
            text += f"<p>Hold {one}, but not {other}:</p><ul>{listed}</ul>"
    return text


def _verdict(verdict: Verdict) -> str:
    words = {True: ("holds", "yes"), False: ("does not hold", "no"), None: ("not decided", "open")}
    word, kind = words[verdict.holds]
    return f'<span class="{kind}">{word}</span><br>{escape(_UNDEFINED.sub("–", verdict.numbers))}'


def _deviations(runs: Runs, points: Lit, examples: Sequence[FromLookin]) -> dict[str, str]:
    """Figure → what differs from the paper's own, as far as its text tells."""
    settings = AsPrinted(runs.sparse, runs.sizes.pixels)
    counted = settings.lookins * settings.pixels**2
    seen = ", ".join(f"{len(e.in_view)} for the lookin on the {e.where.split(',')[0]}" for e in examples)
    level = " ".join(
        f"Here {100 * e.level_share:.0f} % of αB from the {e.where.split(',')[0]} leaves within 45° of the level."
        for e in examples
    )
    sigma = sigma_ps(runs)
    without = [n for n in PEAKS_NS if n not in runs.case("converged").curves.parts]
    parts = f" This room has no {' and no '.join(without)}." if without else ""
    return {
        "3": "<p>Described as: left the inverse square, centre the Lambertian distribution, right both, over N × Ñ = "
        f"{counted:,} observed points. Differs: the corners of the unfolded picture hold no direction, so there are "
        f"{len(points.position):,}; {100 * (1 - points.lit.mean()):.0f} % of them lie in shadow and carry no light; "
        "the view and the colour scale are ours. The lower row has no counterpart in the paper.</p>",
        "5": "<p>Described as: B alone, then with the inverse square, then close up on the field of view, (a) for a "
        "lookin on the nearest wall with cosφ, (b) on the pillar with sinθ, most of whose energy goes into a plane "
        "parallel to the floor and whose points fill a triangle, for the camera's 180° end at the tilted face. "
        f"{level} Differs: the lookins are chosen by rule; sinθ is taken by its modulus, for it is negative on one "
        f"side. Points within the field of view: {seen or 'none'}.</p>",
        "7": "<p>Described as: total black and uppermost, room blue, box purple, pillar orange, secondary red, two "
        "densities. Differs: the room is ours (its peaks stand in the table above); "
        f"σ = {sigma:.0f} ps where the text has {SIGMA_PS:g} ps and the notebook 600 ps FWHM; c is exact where the "
        "notebook has 2.99·10⁸ m/s (0.07 ns at 25 ns). How high the red curve lies in the upper row depends on the "
        f"unit of length and on the reading of α₁ (below).{parts}</p>",
        "9": "<p>Described as Fig. 7, with the strongest secondary path of each lookin alone: lower, narrower, its "
        "peak in the same place. In the lower row the strongest of the observed points is one of "
        f"{runs.sizes.pixels**2:,}: with more of them it would carry less.</p>",
    }


def times(runs: Runs) -> Iterator[str]:
    """The timing claims, published and here."""
    yield "<h2>Seconds</h2>"
    rows = []
    for rays in runs.sizes.rays:
        for scheme in SCHEMES:
            ours = runs.case("as printed", rays, scheme), runs.case("radiometric", rays, scheme)
            name = f"{rays}×{rays}×{runs.sizes.pixels}×{runs.sizes.pixels}, {scheme}"
            published = SECONDS.get((rays, scheme), "–") if runs.sizes.pixels == 60 else "–"
            rows.append((name, escape(published), *(f"{c.seconds:.2f} ({c.processor_s:.2f})" for c in ours)))
    yield table(("secondary paths", "published", "as printed, s", "radiometric, s"), rows)
    saved = {kind: " and ".join(_saved(runs, kind, rays) for rays in runs.sizes.rays) for kind in _ESTIMATORS}
    yield (
        "<p>Elapsed (processor) seconds from rays to envelopes, one core. As printed, every secondary path is formed "
        "by itself, O(Ñ²); radiometrically, paths into and out of a lookin factorise, and all of them cost O(Ñ). "
        f"Processor time for all paths over that for the strongest: as printed {saved['as printed']}, radiometric "
        f"{saved['radiometric']}.</p>"
    )


def _saved(runs: Runs, estimator: Estimator, rays: int) -> str:
    every, strongest = (runs.case(estimator, rays, scheme).processor_s for scheme in SCHEMES)
    return f"{ratio(every, strongest):.1f} at {rays}×{rays}"


def _levels(runs: Runs) -> Iterator[str]:
    yield "<h2>Levels</h2><p>The light of all bins per emitted photon, or what stands for it as printed (mm⁻⁴).</p>"
    rows = [
        (f"as printed, {rays}×{rays}×{runs.sizes.pixels}×{runs.sizes.pixels}", *_level(runs.case("as printed", rays)))
        for rays in runs.sizes.rays
    ]
    rows += [
        (f"as printed, {rays}×{rays}×{runs.sizes.sweep_pixels}×{runs.sizes.sweep_pixels}",
         f"{level.primary:.3e}", f"{level.secondary:.3e}", f"{level.secondary / level.primary:.2e}")
        for rays, level in runs.sweep.items() if level.primary > 0
    ]  # fmt: skip
    rows.append((f"as printed in metres, {runs.sparse}×{runs.sparse}", *_level(runs.in_metres[runs.sparse])))
    for grid in GRIDS:
        for conserved in CONSERVED:
            case = runs.choices[grid, conserved]
            rows.append((f"as printed, {runs.sparse}×{runs.sparse}, grid {grid}, α₁ over {conserved}", *_level(case)))
    rows += [
        (f"radiometric, {rays}² lookins, {runs.sizes.seeds} seeds",
         f"{level.primary:.4e} ± {level.primary_error:.0e}", f"{level.secondary:.4e} ± {level.secondary_error:.0e}",
         f"{level.secondary / level.primary:.3f}")
        for rays, level in runs.radiometric_levels.items() if level.primary > 0
    ]  # fmt: skip
    rows.append((f"radiometric, converged, {runs.sizes.reference} lookins", *_level(runs.case("converged"))))
    yield table(("", "primary", "secondary", "secondary / primary"), rows)
    yield (
        "<p>As printed, sums over B keep the levels from growing with the number of rays itself; what remains is how "
        "near to a corner the rays reach, for 1/R² has no bound there, and the secondary multiplies three of them. "
        "Radiometric weights carry the cosines and areas that bound it.</p>"
    )


def _level(case: Simulation) -> tuple[str, str, str]:
    return f"{case.level['primary']:.3e}", f"{case.level['secondary']:.3e}", f"{case.ratio:.3g}"
