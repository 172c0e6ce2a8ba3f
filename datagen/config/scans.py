"""The key `capture.scan`: where the laser points are, as a grid, a list, a circle, or drawn anew for every scene."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Discriminator, Field, Tag

from datagen.config.base import Settings

LARGEST_SCAN = 65536
PointCount = Annotated[int, Field(ge=1, le=LARGEST_SCAN)]
Metres = Annotated[float, Field(gt=0, le=1e5)]
Coordinate = Annotated[float, Field(ge=-1e6, le=1e6)]
Place = Annotated[tuple[Coordinate, ...], Field(min_length=2, max_length=3)]
"""Two numbers: metres right and up of the middle of the visible relay wall, as the device sees it; three: (x, y, z)
in the room."""


def _kind_required(schema: dict[str, Any]) -> None:
    # A key with a default is optional in JSON Schema, and of all scans only a grid may leave out `kind`.
    schema["required"] = ["kind", *schema.get("required", [])]


class _Spread(Settings):
    """Scans that fill a rectangle on the relay wall."""

    width_m: Metres | None = None
    """Width of the rectangle, for a grid from its first to its last column; left out: 80 % of the visible width, or
    of the largest visible width about `center_m`."""
    height_m: Metres | None = None
    """Height of the rectangle, likewise."""
    center_m: Place | None = None
    """Middle of the rectangle: (right, up) from the middle of the visible relay wall, or (x, y, z) on it; left out:
    the middle of the visible relay wall."""


class _Grid(_Spread):
    """Scans of the points of a regular grid on the visible part of the relay wall."""

    rows: PointCount = 16
    """Points of the grid from top to bottom."""
    columns: PointCount = 16
    """Points of the grid from left to right, as seen from the room."""

    def _check(self) -> None:
        points = self.rows * self.columns
        if points > LARGEST_SCAN:
            raise ValueError(
                f"rows × columns = {self.rows} × {self.columns} = {points}: at most {LARGEST_SCAN} points are "
                "possible; lower one of them"
            )


class GridScan(_Grid):
    """Laser targets on a regular grid on the visible part of the relay wall."""

    kind: Literal["grid"] = "grid"

    @property
    def laser_points(self) -> int:
        """The number of laser points."""
        return self.rows * self.columns


class PointsScan(Settings):
    """Laser targets one by one."""

    model_config = ConfigDict(json_schema_extra=_kind_required)

    kind: Literal["points"] = "points"
    points_m: Annotated[tuple[Place, ...], Field(min_length=1, max_length=LARGEST_SCAN)]
    """Each point: (right, up) from the middle of the visible relay wall, or (x, y, z) on any surface that the laser
    reaches."""

    @property
    def laser_points(self) -> int:
        """The number of laser points."""
        return len(self.points_m)


class _CountedScan(Settings):
    """Scans with a key for the number of laser points."""

    model_config = ConfigDict(json_schema_extra=_kind_required)

    count: PointCount
    """How many laser points."""

    @property
    def laser_points(self) -> int:
        """The number of laser points."""
        return self.count


class CircleScan(_CountedScan):
    """Laser targets at equal steps on a circle, counter-clockwise as the device sees them."""

    kind: Literal["circle"] = "circle"
    radius_m: Metres | None = None
    """Radius of the circle; left out: 80 % of the largest circle on the visible relay wall."""
    center_m: Place | None = None
    """Middle of the circle: (right, up) from the middle of the visible relay wall, or (x, y, z) on it. Left out: that
    middle."""
    start_deg: Annotated[float, Field(ge=-360, le=360)] = 0.0
    """Direction of the first point from the middle: 0 to the right, 90 at the top."""


class RandomScan(_Spread, _CountedScan):
    """Laser targets anywhere in a rectangle, equally likely, drawn anew for every scene."""

    kind: Literal["random"] = "random"


class SubsetScan(_Grid, _CountedScan):
    """Some laser targets of a regular grid, drawn anew for every scene, in the grid's order; all choices are equally
    likely."""

    kind: Literal["subset"] = "subset"

    def _check(self) -> None:
        super()._check()
        if self.count > self.rows * self.columns:
            raise ValueError(
                f"count = {self.count}: the grid has only {self.rows} × {self.columns} = {self.rows * self.columns} "
                "points; lower count or raise rows and columns"
            )


class ImportedScan(_CountedScan):
    """Laser points that an imported dataset holds scene by scene, as its files have them. Written by `datagen
    import`; no dataset can be built with it."""

    is_offered = False

    kind: Literal["imported"] = "imported"
    count: Annotated[int, Field(ge=1, le=2**22)]
    """How many laser points."""


def _kind(scan: Any) -> str | None:
    return str(scan.get("kind", "grid")) if isinstance(scan, dict) else getattr(scan, "kind", None)


AnyScan = Annotated[
    Annotated[GridScan, Tag("grid")] | Annotated[PointsScan, Tag("points")] | Annotated[CircleScan, Tag("circle")]
    | Annotated[RandomScan, Tag("random")] | Annotated[SubsetScan, Tag("subset")]
    | Annotated[ImportedScan, Tag("imported")],
    Discriminator(_kind),
]  # fmt: skip
