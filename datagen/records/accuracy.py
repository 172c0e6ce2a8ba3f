"""The accuracy of a transient: sample counts, or the largest error."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NoReturn

from datagen.errors import InputError
from datagen.records.checks import check_choice, check_flag, check_integer, check_number, shown

MAX_BOUNCES = 64
LIMITS = {
    "lookins": (1, 2**31), "fov_samples": (1, 2**20), "max_bounces": (1, MAX_BOUNCES), "replicates": (1, 1024),
    "observed": (1, 2**24), "max_lookins": (2048, 2**40),
}  # fmt: skip
"""Count → smallest and largest value. The smallest `max_lookins` is what the first round of a target and one more
round need."""
TARGETS = (1e-4, 1.0)
"""Smallest and largest relative L2 error that a target may be."""
CHOSEN_BY_TARGET = ("lookins", "fov_samples", "replicates")
"""The counts that the solver chooses where a target is given."""
FIRST_FOV_SAMPLES = 16
"""FoV points for each hidden vertex in the first round of a target; later rounds take a number that it found."""
PARTS_PER_TARGET = 2.5
"""Default of `part_target` in units of `target`: an object's light as accurate as the whole transient would cost
several times as much."""


class _Default(int):
    """A count that the user left out: a target may choose it, while a count that was given is refused."""


@dataclass(frozen=True)
class Accuracy:
    """How accurately the light is simulated: by sample counts, or to a `target` for which the solver chooses them.

    Attributes
    ----------
    lookins : rays from each laser point into the scene, over all replicates; ≥ 1. Each meets a hidden vertex (the
        paper's lookin, sec. 3.1).
    fov_samples : FoV points to which each vertex of a path is connected, per pixel; ≥ 1.
    max_bounces : highest number of bounces, 3 (the primary) … 64, or 1 and 2 with `direct`; None: paths go on until
        Russian roulette ends them, which leaves no light out on average.
    replicates : independent randomisations of the quasi-random points, which give the standard error; ≥ 1
        (with 1 there is no error estimate). Reduced to `lookins` when that is smaller.
    observed : how the secondary (4 bounces) is computed. None: by path tracing, like all other orders. A number: by
        the paper's factorised scheme, for all paths and without bias, with so many second hidden vertices (the
        paper's observed points) for each hidden vertex. Light that arrives at a hidden vertex and light that leaves
        it are independent on Lambertian surfaces only, so paths by other surfaces are traced. Where surfaces stand
        right beside the field of view, whose light path tracing would seldom meet, None is taken for 64.
    secondary : `"all"` paths; `"none"` leaves the secondary out; `"strongest"` or a number k keeps only the k
        strongest arriving paths of each hidden vertex (the paper's optimised scheme, k = 1), which loses energy and
        needs `observed`.
    direct : also compute the direct return (1 and 2 bounces: the laser point, or a surface it lights, inside the
        FoV), which a gated measurement keeps out.
    occlusion : whether something may stand between a vertex and a FoV point. `"auto"` and `"on"`: a shadow ray is
        sent for every connection that could carry energy (in quadrature `"auto"` saves the rays to surface elements
        that are proven to be wholly visible, which gives the same transient up to the order of summation). `"off"`:
        no shadow ray is sent, which adds light wherever an occluder stands behind the first surface that light meets.
        The factorised secondary (`observed`) always tests for occluders.
    target : largest relative L2 error of the whole transient, ‖error‖ / ‖truth‖ over all laser points, pixels and
        bins, 0.0001 … 1. The solver then chooses lookins, fov_samples, replicates and the method for the secondary;
        giving one of them as well is refused (but for `observed` where only the k strongest paths are kept). The
        target is met when the upper bound of the solver's own error estimate is below it; that estimate does not
        contain the bias of the k strongest paths.
    part_target : with a target: largest relative L2 error of each object's own primary (parts of role `object`), over
        all laser points, pixels and bins, 0.0001 … 1; left out: 2.5 times the target, at most 1.
    faint_part : with a target: objects whose light, over all histograms together, is fewer photons per emitted photon
        than this need not meet `part_target`; ≥ 0.
    max_lookins : with a target: give up (`Transient.met_target` False) before more rays than this, over all
        components, would leave the average laser point; ≥ 2048.

    Examples
    --------
    Sample counts, or the largest error:

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
        """Largest relative L2 error of each object's own light, where a target is set."""
        assert self.target is not None
        return min(PARTS_PER_TARGET * self.target, 1.0) if self.part_target is None else self.part_target

    @property
    def strongest(self) -> int | None:
        """How many arriving paths of each hidden vertex the secondary keeps; None for all."""
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
        if self.max_bounces is not None and self.max_bounces < 3 and (not self.direct or self.target is not None):
            raise InputError(
                f"Accuracy.max_bounces = {self.max_bounces}: light of one and two bounces is direct light, simulated "
                "with sample counts; set direct=True and no target, or take 3 or more"
            )
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
                self._refuse_beside_target(name)
        if self.observed is not None and self.strongest is None:
            self._refuse_beside_target("observed")
        object.__setattr__(self, "fov_samples", _Default(FIRST_FOV_SAMPLES))

    def _refuse_beside_target(self, name: str) -> NoReturn:
        raise InputError(
            f"Accuracy.{name} = {getattr(self, name)!r}: given together with Accuracy.target, which wins and chooses "
            f"it; leave out {name}, or leave out target to fix the counts yourself"
        )
