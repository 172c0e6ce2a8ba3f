"""The accuracy of a transient: sample counts, or an error to be met."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from datagen.errors import InputError
from datagen.records.checks import check_choice, check_flag, check_integer, check_number, shown

MAX_BOUNCES = 64
LIMITS = {
    "lookins": (1, 2**31), "fov_samples": (1, 2**20), "max_bounces": (3, MAX_BOUNCES), "replicates": (1, 1024),
    "observed": (1, 2**24), "max_lookins": (2048, 2**40),
}  # fmt: skip
"""Count → least and largest value. The first round of a target and one more need the least `max_lookins`."""
TARGETS = (1e-4, 1.0)
"""Least and largest relative L2 error that can be asked for."""
CHOSEN_BY_TARGET = ("lookins", "fov_samples", "replicates")
"""The counts that the solver chooses where a target is given."""
FIRST_FOV_SAMPLES = 16
"""FoV points for each vertex in the first round of a target, from which a better number is looked for. Halved, the
first round has fewer connections for each ray, and is noisier."""
PARTS_PER_TARGET = 2.5
"""The default of `part_target`, in units of `target`: half as much would follow each object's light as closely as the
whole, at several times the cost."""


class _Default(int):
    """A count that the user left out. A target chooses such a count, and refuses one that was given."""


@dataclass(frozen=True)
class Accuracy:
    """How exactly to follow the light: sample counts, or a `target` from which the solver chooses them itself.

    Attributes
    ----------
    lookins : rays from each laser point into the scene (paper, sec. 3.1), over all replicates; ≥ 1.
    fov_samples : FoV points that each vertex connects to, per pixel; ≥ 1.
    max_bounces : highest bounce order followed, 3 (the primary) … 64; None follows light until Russian roulette ends
        every path, which leaves nothing out on average.
    replicates : independent randomisations of the quasi-random points, which give the standard error; ≥ 1
        (with 1 there is no error estimate). Reduced to `lookins` when that is smaller.
    observed : how the secondary (4 bounces) is found. None: by the walk that gives all orders. A number: the paper's
        scheme, exactly and for all paths, with so many observed points for each lookin; what arrives at a lookin and
        what leaves it factorise on Lambertian surfaces, and on others the walk takes over. Where surfaces stand right
        beside the field of view, whose light the walk would seldom find, None is taken for 64.
    secondary : `"all"` paths; `"none"` leaves the secondary out; `"strongest"` or a number k keeps only the k
        strongest arriving paths of each lookin (the paper's optimised scheme, k = 1), which loses energy and needs
        `observed`.
    direct : also compute the direct return (1 and 2 bounces: the laser point, or a surface it lights, inside the
        FoV), which a gated measurement keeps out.
    occlusion : whether anything may stand between a vertex and a FoV point. `"auto"` and `"on"`: every connection
        that could carry energy sends a shadow ray (in quadrature `"auto"` saves those to elements that are proven to
        be seen whole, which gives the same transient up to the order of summation); `"off"`: none is sent, as if no
        occluder stood behind the first surface that light meets. That adds light wherever one does.
        The factorised secondary (`observed`) tests what stands between, whatever is set here.
    target : relative L2 error of the whole transient to be met, ‖error‖ / ‖truth‖ over all laser points, pixels and
        bins, 0.0001 … 1. Then the solver chooses lookins, fov_samples, replicates and the way of the secondary, and
        naming one of them too is refused (`observed` belongs to the k strongest paths and stays). What it is held to
        is the upper bound of its own error estimate; the bias of the k strongest paths is not part of it.
    part_target : with a target: relative L2 error of each object's own primary (parts of role `object`), over all
        laser points, pixels and bins, 0.0001 … 1; left out: 2.5 times the target, at most 1.
    faint_part : with a target: photons, per emitted photon and over all histograms together, under which an object's
        light is not held to `part_target`; ≥ 0.
    max_lookins : with a target: give up (`Transient.met_target` False) before more rays than this would leave each
        laser point, on average, over all components; ≥ 2048.

    Examples
    --------
    Counts of samples, or the error to be met:

    >>> import datagen as dg
    >>> dg.Accuracy(lookins=4096, fov_samples=4, max_bounces=4).lookins
    4096
    >>> dg.Accuracy(target=0.02).target
    0.02
    """

    lookins: int = _Default(2048)
    fov_samples: int = _Default(4)
    max_bounces: int | None = 3
    replicates: int = _Default(4)
    direct: bool = False
    observed: int | None = None
    secondary: Literal["all", "none", "strongest"] | int = "all"
    occlusion: Literal["auto", "on", "off"] = "auto"
    target: float | None = None
    part_target: float | None = None
    faint_part: float = 0.0
    max_lookins: int = 1 << 23

    @property
    def each_part(self) -> float:
        """The relative L2 error asked of each object's own light, where a target is set."""
        assert self.target is not None
        return min(PARTS_PER_TARGET * self.target, 1.0) if self.part_target is None else self.part_target

    @property
    def strongest(self) -> int | None:
        """The number of arriving paths of each lookin that the secondary keeps; None for all."""
        if self.secondary == "strongest":
            return 1
        return self.secondary if isinstance(self.secondary, int) else None

    def __post_init__(self) -> None:
        for name, (low, high) in LIMITS.items():
            value = getattr(self, name)
            if name not in ("max_bounces", "observed") or value is not None:
                check_integer("Accuracy", name, value, low, high)
        number = isinstance(self.secondary, int) and not isinstance(self.secondary, bool) and self.secondary >= 1
        if not number and self.secondary not in ("all", "none", "strongest"):
            raise InputError(
                f"Accuracy.secondary = {shown(self.secondary)}: must be 'all', 'none', 'strongest' or an integer ≥ 1"
            )
        check_choice("Accuracy.occlusion", self.occlusion, ("auto", "on", "off"))
        if self.strongest is not None and self.observed is None:
            raise InputError(
                f"Accuracy.secondary = {self.secondary!r}: ranks observed points' paths; set observed, such as 3600"
            )
        check_flag("Accuracy.direct", self.direct)
        check_number("Accuracy", "faint_part", self.faint_part, 0.0, 1e30, "photons")
        for name in ("target", "part_target"):
            if getattr(self, name) is not None:
                check_number("Accuracy", name, getattr(self, name), *TARGETS, "a relative L2 error; 2 % is 0.02")
        if self.target is not None:
            self._leave_to_target()
        elif self.part_target is not None:
            raise InputError(f"Accuracy.part_target = {self.part_target!r}: needs a target; set target, too")

    def _leave_to_target(self) -> None:
        """Refuse counts that were given with a target, which chooses them."""
        for name in CHOSEN_BY_TARGET:
            if not isinstance(getattr(self, name), _Default):
                raise InputError(chosen_by_target("Accuracy.", name, getattr(self, name)))
        if self.observed is not None and self.strongest is None:
            raise InputError(chosen_by_target("Accuracy.", "observed", self.observed))
        object.__setattr__(self, "fov_samples", _Default(FIRST_FOV_SAMPLES))


def chosen_by_target(prefix: str, name: str, value: object) -> str:
    """The message of refusal where both a target and a sample count that it chooses are given."""
    return (
        f"{prefix}{name} = {value!r}: given together with {prefix}target, which wins and chooses it; "
        f"leave out {name}, or leave out target to fix the counts yourself"
    )
