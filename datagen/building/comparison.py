"""A stored scene compared with the same scene made again, stage by stage and field by field."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from datagen.errors import CheckError, as_line
from datagen.pipeline import STAGES, Stage, stage_of_parameter
from datagen.records import Scalar
from datagen.records.agreement import (
    Agreement,
    counts_agreement,
    counts_in_spans,
    light_agreement,
    same_parameter,
    same_to_rounding,
)
from datagen.store.environment import environment_differences, made_with
from datagen.store.reader import DatasetReader
from datagen.store.record import SceneRecord, ShardRecord
from datagen.store.scenes import Scenes
from datagen.store.schema import Field, Schema
from datagen.store.shard import digest

Verdict = Literal["same", "agrees", "differs", "damaged", "not stored"]
"""`agrees`: differs by no more than another processor or version may make it differ. `damaged`: what is stored is not
what was written, or cannot be read; made again it is what was written."""

EDGE_SHARE = 0.01
"""Largest share of the values of a label that may be others on another processor: of rays that just meet or just miss
an edge, where labels are seen along rays; a pixel of an image of 10 × 10 is as much."""
LABEL_ROUNDING = 1e-5
"""Relative difference up to which values of labels, which are single precision, are the same to rounding."""
COUNTED_BY_RAYS = ".seen_fraction"
"""End of the names of what is drawn for a room and counted by rays, of which one may just miss an edge elsewhere."""
SHOWN_NAMES = 3
"""Parameters that differ and are named in one line; how many more there are is said."""


@dataclass(frozen=True)
class Again:
    """A scene made again.

    record : what a build would record of it; why it could not be made, if it could not.
    values : field of the dataset → values in the type in which they are stored.
    light : L2 norm of its transient.
    warnings : what was warned of while it was made.
    """

    record: SceneRecord
    values: Mapping[str, NDArray[Any]]
    light: float
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class Row:
    """The comparison of one field, or of the parameters of one stage.

    shape : of the field, or the number of parameters.
    words : what was found, in words. is_other : whether what is made again is not what was written, by more than
        another processor or version explains; of damaged values it may be unknown, and is False then.
    """

    stage: str
    name: str
    shape: str
    verdict: Verdict = "same"
    words: str = ""
    is_other: bool = False


@dataclass(frozen=True)
class Comparison:
    """A stored scene and the same scene made again.

    where : the dataset. seed : its seed.
    shard : record of the shard that holds the scene. stored : the scene's own.
    elsewhere : what differs in the versions and the processor with which it was made then and now.
    rows : fields and parameters in the order of the stages; empty if it could not be made then, or not now.
    """

    where: str
    index: int
    seed: int
    shard: ShardRecord
    stored: SceneRecord
    again: Again
    elsewhere: tuple[str, ...]
    rows: tuple[Row, ...]

    @cached_property
    def differing(self) -> tuple[Row, ...]:
        """The rows that differ by more than another processor or version explains."""
        return tuple(row for row in self.rows if row.is_other)

    @cached_property
    def damaged(self) -> tuple[Row, ...]:
        """The rows whose stored values are not as they were written."""
        return tuple(row for row in self.rows if row.verdict == "damaged")

    @property
    def first(self) -> str | None:
        """The first stage that differs."""
        return self.differing[0].stage if self.differing else None

    def problem(self) -> str | None:
        """One line on what is wrong with the scene, or None."""
        scene = f"{self.where}: scene {self.index}"
        if self.again.record.failure is not None:
            return f"{scene} cannot be made again: {self.again.record.failure}"
        if self.stored.failure is not None:
            return (
                f"{scene} could not be made when it was built ({self.stored.failure}), and can be made now; run the "
                "same `datagen build` again, which tries it once more"
            )
        found = []
        if self.differing:
            names = ", ".join(row.name for row in self.differing if row.stage == self.first)
            before = [stage.name for stage in STAGES][: [stage.name for stage in STAGES].index(str(self.first))]
            same = f"; {_name_list(before)} before it {'are' if len(before) > 1 else 'is'} the same" if before else ""
            found.append(f"the first stage that differs is {self.first} ({names}){same}")
        if self.damaged:
            names = ", ".join(row.name for row in self.damaged)
            found.append(
                f"{names}: damaged; run the same `datagen build` again to make shard {self.shard.shard} anew"
            )
        return f"{scene}: {'; '.join(found)}" if found else None

    def text(self) -> str:
        """The table of all fields, for people."""
        return "\n".join(map(as_line, self._lines()))

    def _lines(self) -> Iterator[str]:
        tries = [f"{name} {self.stored.parameters[name]}" for name in _TRIES if name in self.stored.parameters]
        yield f"{self.where}, scene {self.index}: made again from its configuration and seed {self.seed}"
        if tries:
            yield f"room        {', '.join(tries)}"
        by, now = self.shard.made_by, made_with()
        yield f"made by     {_environment(by)}"
        if self.elsewhere:
            yield f"this is     {_environment(now)}"
            yield f"differs in  {'; '.join(self.elsewhere)}"
            yield f"{'':12}so rooms must be the same to rounding, light within the errors that both claim, and counts"
            yield f"{'':12}within what these and chance allow"
        elif by["commit"] != now["commit"]:
            yield f"this is     commit {_commit(now)}, of the same version: all must be the same to the bit"
        else:
            yield "this is     the same: all must be the same to the bit"
        yield from (f"warning     {warning}" for warning in self.again.warnings)
        if self.rows:
            yield ""
            yield from self._table()
            yield ""
            yield from self._ending()

    def _table(self) -> Iterator[str]:
        """A line for each row; the first one of a stage has the seconds that the stage took now, and then."""
        head = ("stage", "field", "shape", "seconds", "then", "made again")
        lines, stage = list[tuple[str, ...]]([head]), ""
        for row in self.rows:
            begins, stage = row.stage != stage, row.stage
            seconds = [self._seconds(record, stage) if begins else "" for record in (self.again.record, self.stored)]
            what = row.verdict if not row.words else f"{row.verdict}: {row.words}"
            lines.append((stage if begins else "", row.name, row.shape, *seconds, what))
        wide = [max(len(line[column]) for line in lines) for column in range(len(head) - 1)]
        for line in lines:
            cells = [
                cell.rjust(width) if column in (3, 4) else cell.ljust(width)
                for column, (cell, width) in enumerate(zip(line, wide, strict=False))
            ]
            yield "  ".join((*cells, line[-1])).rstrip()

    @staticmethod
    def _seconds(record: SceneRecord, stage: str) -> str:
        """Seconds that a stage took; empty where a stage has none of its own."""
        keys = next(of.seconds for of in STAGES if of.name == stage)
        taken = [record.seconds[key] for key in keys if key in record.seconds]
        return f"{sum(taken):.3f}" if taken else ""

    def _ending(self) -> Iterator[str]:
        verdicts: list[Verdict] = [row.verdict for row in self.rows if row.verdict != "not stored"]
        number = {words: verdicts.count(verdict) for verdict, words in _IN_SUM.items()}
        yield f"of {len(verdicts)}: {', '.join(f'{count} {words}' for words, count in number.items() if count)}"
        stages = {row.stage for row in self.differing}
        if self.first is not None:
            yield f"first stage that differs: {self.first}"
        if {"light", "labels"} <= stages and self.first == "light":
            yield (
                "labels, which are made from the room alone, differ too: so the room differs in shapes or materials, "
                "of which a dataset keeps what was drawn and no triangles"
            )


_IN_SUM: dict[Verdict, str] = {
    "same": "the same", "agrees": "in agreement", "differs": "different", "damaged": "damaged",
}  # fmt: skip
_TRIES = ("draws", "attempts", "evidence.placed_anew")
"""Parameters that say how often a room, or its objects, were drawn until one met all constraints."""


def compare(scenes: Scenes, shard: ShardRecord, stored: SceneRecord, again: Again) -> Comparison:
    """What is stored of a scene, compared with the scene made again. Damaged values are told, not raised."""
    manifest = scenes.manifest
    elsewhere = tuple(environment_differences([shard.made_by, made_with()], also=("processor",)))
    rows: tuple[Row, ...] = ()
    if stored.failure is None and again.record.failure is None:
        reader = DatasetReader(scenes.root, manifest, manifest.schema.by_name, check=False)
        rows = tuple(_Judge(manifest.schema, reader, stored, again, bool(elsewhere)).rows())
    return Comparison(str(scenes.root), stored.index, manifest.seed, shard, stored, again, elsewhere, rows)


@dataclass(frozen=True)
class _Judge:
    """Judges all fields of one scene.

    reader : compares no digests, which are compared here: damage is told from another result.
    elsewhere : whether another processor or version made what is stored.
    """

    schema: Schema
    reader: DatasetReader
    stored: SceneRecord
    again: Again
    elsewhere: bool

    def rows(self) -> list[Row]:
        """A row for each field, and for the parameters of each stage, in the order of the stages.

        What follows from the light may differ with it: it agrees as long as no stage before it differs.
        """
        found, names = list[Row](), self.schema.by_name
        for stage in STAGES:
            # Of light and counts the first field is what all others follow from.
            told = stage.fields[:1] if stage.name in ("light", "counts") else ()
            for name in stage.fields:
                if name in names:
                    found.append(self._field(stage, names[name]))
                elif name in told:
                    found.append(Row(stage.name, name, "", "not stored"))
            found += self._parameters(stage, not any(row.is_other for row in found))
        return found

    def _claims(self, objects: bool = False) -> tuple[float, float]:
        """The relative errors of the light that were claimed then, and are now; NaN where one is unknown.

        objects : the largest claim, if those of the objects' own light count, too.
        """
        now, both = self.again.record.parameters, list[float]()
        for claimed in (self.stored.parameters, now):
            # What another version did not record counts as it is claimed now.
            whole = claimed.get("transient.relative_error", now.get("transient.relative_error"))
            parts = [value for name, value in claimed.items() if name.startswith("transient.part_error.")]
            both.append(float(np.max([_number(value) for value in (whole, *(parts if objects else ()))])))
        return both[0], both[1]

    def _field(self, stage: Stage, field: Field) -> Row:
        due, made = self.stored.digests[field.name], self.again.record.digests[field.name]
        row = Row(stage.name, field.name, " × ".join(map(str, field.shape)) or "1")
        values, is_other = self.again.values[field.name], made != due and not self.elsewhere
        again = f"made again it is {'what' if made == due else 'not what'} was written"
        try:
            kept = self.reader.read(field.name, [self.stored.index])[0]
        except CheckError as error:
            # Where all others end in the remedy, this one is followed by it.
            words = f"{str(error).partition('; run the same')[0]}; {again}"
            return replace(row, verdict="damaged", words=words, is_other=is_other)
        here = digest(field, kept)
        if here == due:
            return row if made == due else self._judged(row, stage, values, kept)
        if here == made:
            words = "its record states other values than are stored, and the stored ones are what is made again"
            return replace(row, verdict="damaged", words=words)
        words = f"stored are other values than were written, and {again}; {_differ(values, kept)}"
        return replace(row, verdict="damaged", words=words, is_other=is_other)

    def _judged(self, row: Row, stage: Stage, made: NDArray[Any], kept: NDArray[Any]) -> Row:
        """The row of a field that is as it was written, and differs from what was made again."""
        words = _differ(made, kept)
        if stage.name == "light":
            agreement = light_agreement(made, kept, self.again.light, sum(self._claims()))
            words, agrees = f"{words}; {_by(agreement, self._claims())}", agreement.holds
        elif stage.name == "counts":
            agreement = self._counts(made, kept)
            words, agrees = f"{words}; {_over_time(agreement)}", agreement.holds
        elif stage.name == "evidence":
            size = float(np.linalg.norm(np.nan_to_num(np.asarray(made, np.float64))))
            claims = self._claims(objects=True)
            agreement = light_agreement(made, kept, size, sum(claims))
            words, agrees = f"{words}; {_by(agreement, claims)}", agreement.holds
        elif stage.name == "labels":
            others = ~np.isclose(made, kept, rtol=LABEL_ROUNDING, atol=LABEL_ROUNDING, equal_nan=True)
            agrees = int(others.sum()) <= EDGE_SHARE * others.size
        else:
            agrees = bool(same_to_rounding(made, kept).all())
        return self._with_verdict(row, agrees, words)

    def _with_verdict(self, row: Row, agrees: bool, words: str) -> Row:
        """The row of what differs. agrees : whether another processor or version would explain it."""
        explained = agrees and self.elsewhere
        return replace(row, verdict="agrees" if explained else "differs", words=words, is_other=not explained)

    def _counts(self, made: NDArray[Any], kept: NDArray[Any]) -> Agreement:
        drawn = float(made.sum(dtype=np.float64) + kept.sum(dtype=np.float64))
        return counts_agreement([counts_in_spans(made)], [counts_in_spans(kept)], [sum(self._claims())], drawn)

    def _parameters(self, stage: Stage, sound: bool) -> Iterator[Row]:
        """The row of the parameters of a stage, if it has any. sound : whether no row before it differs."""
        made, kept = (
            {name: value for name, value in of.items() if stage_of_parameter(name) is stage}
            for of in (self.again.record.parameters, self.stored.parameters)
        )
        names = [*dict.fromkeys([*kept, *made])]
        others = [name for name in names if not _equal(made.get(name), kept.get(name))]
        row = Row(stage.name, "parameters", str(len(names)))
        if others:
            # Another version may record other things.
            both = [name for name in others if name in made and name in kept]
            agrees = all(self._parameter_agrees(stage, name, made[name], kept[name], sound) for name in both)
            said = [
                f"{name} {_as_text(made.get(name))}, stored {_as_text(kept.get(name))}" for name in both or others
            ]
            more = f"; and {len(others) - SHOWN_NAMES} more" if len(others) > SHOWN_NAMES else ""
            words = f"{len(others)} of {len(names)}: {'; '.join(said[:SHOWN_NAMES])}{more}"
            row = self._with_verdict(row, agrees, words)
        if names:
            yield row

    def _parameter_agrees(self, stage: Stage, name: str, made: Scalar, kept: Scalar, sound: bool) -> bool:
        if stage.name in ("room", "capture", "detector"):
            return name.endswith(COUNTED_BY_RAYS) or same_parameter(made, kept)
        if name == "transient.energy":
            # All that is known of the light where the transient is not stored.
            return light_agreement(_number(made), _number(kept), float(_number(kept)), sum(self._claims())).holds
        return sound


def _environment(made_by: Mapping[str, str]) -> str:
    return f"datagen {made_by['datagen']}, commit {_commit(made_by)}, on {made_by['processor']}"


def _commit(made_by: Mapping[str, str]) -> str:
    """The commit in short, with the mark of a checkout that was modified."""
    commit, changed, _ = made_by["commit"].partition("+")
    return f"{commit[:12]}{changed and '+changes'}"


def _number(value: Scalar | None) -> NDArray[np.float64]:
    return np.array(value if isinstance(value, int | float) else math.nan, np.float64)


def _equal(made: Scalar | None, kept: Scalar | None) -> bool:
    return made == kept or (made != made and kept != kept)


def _as_text(value: Scalar | None) -> str:
    return "none" if value is None else f"{value:.6g}" if isinstance(value, float) else str(value)


def _by(agreement: Agreement, claims: tuple[float, float]) -> str:
    """By how much light differs, and what is claimed, in words."""
    by = f"by {_share(agreement.difference)} of the whole"
    if math.isnan(agreement.allowed):
        return f"{by}, and no error is claimed"
    return f"{by}, claimed are {_share(claims[0])} then and {_share(claims[1])} now"


def _over_time(agreement: Agreement) -> str:
    """By how much counts differ over time, and what chance and the light allow, in words."""
    over = f"over time by {_share(agreement.difference)} in all"
    if math.isnan(agreement.allowed):
        return f"{over}, and no error of the light is claimed"
    than = "no more" if agreement.holds else "more"
    return f"{over}, {than} than the {_share(agreement.allowed)} that the light's claimed errors and chance allow"


def _share(number: float) -> str:
    return f"{100 * number:.{'2g' if number < 1 else '0f'}} %"


def _differ(made: NDArray[Any], kept: NDArray[Any]) -> str:
    """How many values differ, and the largest difference with its place, in words."""
    made, kept = np.asarray(made), np.asarray(kept)
    same = made == kept
    if made.dtype.kind == "f":
        same |= np.isnan(made) & np.isnan(kept)
    off = np.abs(made.astype(np.float64) - kept.astype(np.float64))
    # A number where none is stored, or none where one is, is the largest difference there is.
    off = np.where(same, 0.0, np.where(np.isnan(off), np.inf, off))
    where = np.unravel_index(int(np.argmax(off)), off.shape)
    place = f" at ({', '.join(map(str, map(int, where)))})" if off.ndim else ""
    numbers = f"{_as_text(made[where].item())}, stored {_as_text(kept[where].item())}"
    return f"{int((~same).sum())} of {same.size} values, most by {off[where]:.3g}{place}: {numbers}"


def _name_list(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
