"""How finely to follow the light."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from datagen.errors import InputError

MAX_BOUNCES = 64


@dataclass(frozen=True)
class Accuracy:
    """Sample counts of the transport solver.

    Attributes
    ----------
    lookins : rays from each laser point into the scene (paper, sec. 3.1), over all scramblings; ≥ 1.
    fov_samples : FoV points that each vertex connects to, per pixel; ≥ 1.
    max_bounces : highest bounce order followed, 3 (the primary) … 64; None follows light until Russian roulette ends
        every path, which leaves nothing out on average.
    scramblings : independent randomisations of the quasi-random points, which give the standard error; ≥ 1
        (with 1 there is no error estimate). Reduced to `lookins` when that is smaller.
    observed : how the secondary (4 bounces) is found. None: by the walk that gives all orders. A number: the paper's
        scheme, exactly and for all paths, with so many observed points for each lookin; what arrives at a lookin and
        what leaves it factorise on Lambertian surfaces, and on others the walk takes over.
    secondary : `"all"` paths; `"none"` leaves the secondary out; `"strongest"` or a number k keeps only the k
        strongest arriving paths of each lookin (the paper's optimised scheme, k = 1), which loses energy and needs
        `observed`.
    direct : also compute the direct return (1 and 2 bounces: the laser point, or a surface it lights, inside the
        FoV), which a gated measurement keeps out.
    """

    lookins: int = 2048
    fov_samples: int = 16
    max_bounces: int | None = 3
    scramblings: int = 8
    direct: bool = False
    observed: int | None = None
    secondary: Literal["all", "none", "strongest"] | int = "all"

    @property
    def strongest(self) -> int | None:
        """How many arriving paths of each lookin the secondary keeps; None for all."""
        if self.secondary == "strongest":
            return 1
        return self.secondary if isinstance(self.secondary, int) else None

    def __post_init__(self) -> None:
        for name, low, high in (
            ("lookins", 1, 2**31),
            ("fov_samples", 1, 2**20),
            ("max_bounces", 3, MAX_BOUNCES),
            ("scramblings", 1, 1024),
            ("observed", 1, 2**24),
        ):
            value = getattr(self, name)
            if name in ("max_bounces", "observed") and value is None:
                continue
            if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
                raise InputError(f"Accuracy.{name} = {value!r}: must be an integer in {low} … {high}")
        number = isinstance(self.secondary, int) and not isinstance(self.secondary, bool) and self.secondary >= 1
        if not number and self.secondary not in ("all", "none", "strongest"):
            raise InputError(
                f"Accuracy.secondary = {self.secondary!r}: must be 'all', 'none', 'strongest' or an integer ≥ 1"
            )
        if self.strongest is not None and self.observed is None:
            raise InputError(
                f"Accuracy.secondary = {self.secondary!r}: ranks observed points' paths; set observed, such as 3600"
            )
