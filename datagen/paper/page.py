"""The page: what of the paper holds, its figures, times and levels, and what had to be chosen."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from html import escape

from datagen.paper.as_printed import AsPrinted
from datagen.paper.envelope_figures import sigma_ps
from datagen.paper.measures import PEAKS_NS, SECONDS, SIGMA_PS
from datagen.paper.room_samples import FromLookin, Lit
from datagen.paper.runs import SCHEMES, Estimator, Runs
from datagen.paper.statements import Statement, Verdict, ratio
from datagen.report.html import head, table
from datagen.store.environment import processor

_UNDEFINED = re.compile(r"[+-]?\bnan\b")
_ESTIMATORS: tuple[Estimator, ...] = ("as printed", "radiometric")


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
    yield (
        "<h2>Levels</h2><p>The light of all bins, and what it comes to with other grids of rays, units and readings "
        "of α₁, stands in <code>numbers.json</code>. As printed, sums over B keep the levels from growing with the "
        "number of rays itself; what remains is how near to a corner the rays reach, for 1/R² has no bound there, "
        "and the secondary multiplies three of them. Radiometric weights carry cosines and areas that bound it.</p>"
        "<h2>What the text leaves open</h2><p>What was taken, and the other readings: <code>docs/paper.md</code>, "
        "and the docstrings of <code>dg.AsPrinted</code> and <code>dg.simulate_as_printed</code>.</p></body></html>"
    )


def _summary(statements: Sequence[Statement]) -> str:
    def count(kind: str) -> str:
        verdicts = [getattr(s, kind) for s in statements]
        decided = [v.holds for v in verdicts if v.holds is not None]
        return f"{sum(decided)} of {len(decided)}"

    return (
        f"<p>Of the statements that this room can decide, {count('printed')} hold as printed and "
        f"{count('radiometric')} with correct radiometry.</p>"
    )


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
        "3": f"<p>Of N × Ñ = {counted:,} observed points {len(points.position):,} are there: the corners of the "
        "unfolded picture hold no direction. View and colour scale are ours; the lower row has no counterpart in the "
        "paper.</p>",
        "5": "<p>In the paper, most of the energy of the pillar's lookin goes into a plane parallel to the floor, "
        f"and its points fill a triangle, for the camera's 180° end at the tilted face. {level} Differs: the lookins "
        "are chosen by rule; sinθ is taken by its modulus, for it is negative on one side. Points within the field "
        f"of view: {seen or 'none'}.</p>",
        "7": f"<p>The room is ours (its peaks stand in the table above); σ = {sigma:.0f} ps where the text has "
        f"{SIGMA_PS:g} ps and the notebook 600 ps FWHM; c is exact where the notebook has 2.99·10⁸ m/s (0.07 ns at "
        "25 ns). How high the red curve lies in the upper row depends on the unit of length and on the reading of α₁."
        f"{parts}</p>",
        "9": "<p>In the lower row the strongest of the observed points is one of "
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
