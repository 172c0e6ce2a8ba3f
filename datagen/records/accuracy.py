"""How finely to follow the light."""

from __future__ import annotations

from dataclasses import dataclass

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
    direct : also compute the direct return (1 and 2 bounces: the laser point, or a surface it lights, inside the
        FoV), which a gated measurement keeps out.
    """

    lookins: int = 2048
    fov_samples: int = 16
    max_bounces: int | None = 3
    scramblings: int = 8
    direct: bool = False

    def __post_init__(self) -> None:
        for name, low, high in (
            ("lookins", 1, 2**31),
            ("fov_samples", 1, 2**20),
            ("max_bounces", 3, MAX_BOUNCES),
            ("scramblings", 1, 1024),
        ):
            value = getattr(self, name)
            if name == "max_bounces" and value is None:
                continue
            if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
                raise InputError(f"Accuracy.{name} = {value!r}: must be an integer in {low} … {high}")
