"""The table of labels: every array of ground truth that a dataset can hold, what it means, and how it is drawn.

A new label is a row here and a function in the module that the row names; the configuration, the stored schema, the
statistics, the pictures and the pages of documentation follow from the row.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

LabelName = Literal[
    "depth", "normal", "albedo", "part_id", "shaded", "evidence", "occupancy", "sdf", "objects", "presence",
    "zone_depth",
]  # fmt: skip
"""The names that `store.fields` takes. Each stands for the arrays of all its rows in `LABEL_FIELDS`."""
OverFrames = Literal["own", "same", "only"]
"""Of a sequence each frame has a value of its `own`, all have the `same`; or `only` sequences have it, by frame."""
Scale = Literal["linear", "from zero", "zero to one", "square root", "logarithmic", "about zero"]


@dataclass(frozen=True)
class Look:
    """How an image is drawn.

    title : what it shows, with the unit.
    colors : a colour map of matplotlib; `parts`: the colour of each part; `directions`: red, green and blue are
        right, up and towards the wall.
    scale : how values become colours.
    least : smaller values are left white; None: none is.
    along_depth : how a column of voxels becomes a pixel.
    """

    title: str
    colors: str
    scale: Scale = "linear"
    least: float | None = None
    along_depth: Literal["mean", "least"] = "mean"


@dataclass(frozen=True)
class LabelField:
    """One array of ground truth.

    label : the name in `store.fields` that asks for it.
    name : the name of the array.
    made_by : the module of `datagen` that makes it.
    dims : names of its axes in one scene, or in one frame of it. `row`, `column` and the voxels are sized by the
        section `labels`, `object` by the most objects that a scene can have.
    dtype, unit, meaning : as they are stored; the meaning says which value stands for nothing.
    look : how it is drawn; None: not as an image.
    over_frames : whether the frames of a sequence have values of their own, on a leading axis `frame`.
    """

    label: LabelName
    name: str
    made_by: str
    dims: tuple[str, ...]
    dtype: str
    unit: str
    meaning: str
    look: Look | None = None
    over_frames: OverFrames = "own"

    def dims_in(self, sequence: bool) -> tuple[str, ...]:
        """Names of its axes in one scene of a dataset."""
        return ("frame", *self.dims) if sequence and self.over_frames != "same" else self.dims

    @property
    def is_image(self) -> bool:
        """Whether it has a value for each label pixel."""
        return self.dims[:2] == ("row", "column")

    @property
    def is_volume(self) -> bool:
        """Whether it has a value for each voxel."""
        return "voxel_depth" in self.dims

    @property
    def is_quantity(self) -> bool:
        """Whether its values are quantities of an image or a volume, of which a mean makes sense, and not indices."""
        return (self.is_image or self.is_volume) and not self.dtype.startswith("int")


_IMAGE, _VOLUME = ("row", "column"), ("voxel_depth", "voxel_row", "voxel_column")
_FRAME = "of the label frame (right, up, depth from the middle of hidden_view)"

LABEL_FIELDS = (
    LabelField("depth", "depth", "labels.images", _IMAGE, "float32", "m",
               "distance of the surface seen from the plane of the relay wall, along its normal; 0: empty",
               Look("Depth (m)", "viridis_r", least=1e-9)),
    LabelField("normal", "normal", "labels.images", (*_IMAGE, "axis"), "float32", "1",
               "unit normal of the surface seen along (right, up, wall normal), its third component never positive; "
               "0: empty",
               Look("Normal", "directions")),
    LabelField("albedo", "albedo", "labels.images", _IMAGE, "float32", "1",
               "albedo of the surface seen; 0: empty",
               Look("Albedo", "gray", "zero to one")),
    LabelField("part_id", "part_id", "labels.images", _IMAGE, "int16", "1",
               "index of the part seen in the parameter scene.part_names; -1: empty",
               Look("Part", "parts")),
    LabelField("shaded", "shaded", "labels.shading", _IMAGE, "float32", "radiance of the lamp",
               "radiance of the surface seen, lit by the visible relay wall (radiance 1) and dimly from elsewhere, "
               "with shadows; linear; 0: empty",
               Look("Shaded (lit relay wall: 1)", "gray", "square root")),
    LabelField("evidence", "evidence", "evidence.image", _IMAGE, "float32", "counts",
               "expected detections of light of three bounces by way of the surface seen, over the scan; 0: empty",
               # Less than one detection in a thousand exposures is left white.
               Look("Evidence (detections)", "magma", "logarithmic", least=1e-3)),
    LabelField("occupancy", "occupancy", "labels.volumes", _VOLUME, "uint8", "1",
               "1 where an object is",
               Look("Occupied share of depth", "cividis", "from zero")),
    LabelField("sdf", "sdf", "labels.volumes", _VOLUME, "float32", "m",
               "distance to the nearest object surface, negative inside",
               Look("Least signed distance (m)", "RdBu", "about zero", along_depth="least")),
    LabelField("objects", "object_count", "labels.boxes", (), "int32", "1",
               "number of objects; rows beyond it are fill", over_frames="same"),
    LabelField("objects", "object_class", "labels.boxes", ("object",), "int16", "1",
               "class of the object, an index into this field's list of classes; -1: no object in this row",
               over_frames="same"),
    LabelField("objects", "object_part", "labels.boxes", ("object",), "int16", "1",
               "index of the object in the parameter scene.part_names, as in part_id; -1: no object",
               over_frames="same"),
    LabelField("objects", "object_box_center", "labels.boxes", ("object", "axis"), "float32", "m",
               f"middle of the object's box along the axes {_FRAME}; 0: no object"),
    LabelField("objects", "object_box_size", "labels.boxes", ("object", "axis"), "float32", "m",
               "extent of the box along the object's own width, depth and height; 0: no object", over_frames="same"),
    LabelField("objects", "object_box_rotation", "labels.boxes", ("object", "axis", "own_axis"), "float32", "1",
               "columns: unit vectors of the object's own width, depth (its back at +) and height along the axes "
               f"{_FRAME}; 0: no object"),
    LabelField("objects", "object_velocity", "labels.motion", ("object", "axis"), "float32", "m/s",
               f"velocity of the middle of the object's box along the axes {_FRAME}; 0: it stands, or no object",
               over_frames="only"),
    LabelField("objects", "object_turning", "labels.motion", ("object", "axis"), "float32", "rad/s",
               f"angular velocity of the object, a vector along the axes {_FRAME}; 0: it does not turn, or no object",
               over_frames="only"),
    LabelField("objects", "object_detections", "evidence.own", ("object",), "float32", "counts",
               "expected detections of the object's own light of three bounces, over the scan; 0: no object"),
    LabelField("objects", "object_brightest_bin", "evidence.own", ("object",), "float32", "counts",
               "the same in the bin where they are most; 0: no object"),
    LabelField("objects", "object_significance", "evidence.own", ("object",), "float32", "1",
               "sqrt(sum s^2 / b) over all bins, s its expected detections, b all: standard deviations of an ideal "
               "matched filter; 0: no object"),
    LabelField("objects", "object_change", "evidence.change", ("object",), "float32", "1",
               "sqrt(sum d^2 / (b + b')) over all bins, d what the expected detections change by the object since "
               "the frame before, b and b' all in both frames: standard deviations of an ideal matched filter on "
               "their difference; d is of the object's own light, and of what it blocks if nothing else moves; 0: "
               "it stands, the first frame, or no object",
               over_frames="only"),
    LabelField("objects", "object_change_floor", "evidence.change", ("object",), "float32", "1",
               "the object_change that the error of the simulation alone would have; 0 as there",
               over_frames="only"),
    LabelField("presence", "object_presence", "evidence.presence", ("object",), "float32", "1",
               "sqrt(sum s^2 / m) over all bins, s what the object adds to the expected detections, m those with or "
               "without it, whichever are more: standard deviations of an ideal matched filter; 0: no object"),
    LabelField("zone_depth", "zone_depth", "devices", ("sensor_pixel",), "float32", "m",
               "depth of what each zone (or pixel) sees first, from the sensor along the zone's axis: mean over its "
               "footprint, weighted by its sensitivity; NaN where it sees nothing"),
)  # fmt: skip


def names_made_by(module: str) -> tuple[str, ...]:
    """Names of the arrays that a module makes."""
    return tuple(of.name for of in LABEL_FIELDS if of.made_by == module)


def drawn_fields() -> dict[str, LabelField]:
    """The arrays that are drawn as images, by name."""
    return {of.name: of for of in LABEL_FIELDS if of.look is not None}
