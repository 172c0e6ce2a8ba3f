"""The table of labels against those who use it: the configuration, the makers, the schema, the page of datasets."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import get_args

import numpy as np
from handmade_rooms import l_corridor

from datagen.config import LabelsConfig, config_from_mapping
from datagen.labels import LABEL_MAKERS, make_labels
from datagen.records.label_fields import LABEL_FIELDS, LabelName, drawn_fields
from datagen.store.schema import schema_of
from datagen.store.shard import encoded_value


def test_every_name_of_the_configuration_has_rows_and_every_row_a_name() -> None:
    assert {of.label for of in LABEL_FIELDS} == set(get_args(LabelName))
    assert len({of.name for of in LABEL_FIELDS}) == len(LABEL_FIELDS)
    for of in LABEL_FIELDS:
        import_module(f"datagen.{of.made_by}")


def test_labels_are_made_as_the_table_says() -> None:
    config = LabelsConfig(rows=4, columns=5, voxels=(2, 3, 4))
    made = make_labels(config, l_corridor(), LABEL_MAKERS)
    rows = {of.name: of for of in LABEL_FIELDS if of.made_by.startswith("labels.") and of.over_frames != "only"}
    assert set(made) == set(rows)
    sizes = {"row": 4, "column": 5, "axis": 3, "own_axis": 3, "voxel_depth": 2, "voxel_row": 3, "voxel_column": 4,
             "object": 2}  # fmt: skip
    for name, values in made.items():
        assert values.dtype == np.dtype(rows[name].dtype), name
        assert values.shape == tuple(sizes[dim] for dim in rows[name].dims), name


def test_the_schema_has_every_row_of_the_labels_asked_for() -> None:
    values = {"store": {"fields": ["histogram", *get_args(LabelName)]}, "detector": {"cycles": 3000}}
    for sequence in (False, True):
        config = config_from_mapping({**values, **({"sequence": {"frames": 4, "rate_hz": 10}} if sequence else {})})
        fields = schema_of(config).by_name
        for of in LABEL_FIELDS:
            assert (of.name in fields) == (sequence or of.over_frames != "only")
            if (field := fields.get(of.name)) is None:
                continue
            frame = ("frame",) if sequence and of.over_frames != "same" else ()
            assert field.dims == ("scene", *frame, *of.dims) and field.shape[: len(frame)] == (4,) * len(frame)
            assert (field.dtype, field.unit) == (of.dtype, of.unit)
            assert encoded_value(field, np.zeros(field.shape, of.dtype)).dtype == np.dtype(of.dtype)
    assert {name for name, of in drawn_fields().items() if of.is_image or of.is_volume} == set(drawn_fields())


def test_the_page_of_datasets_names_every_label() -> None:
    page = (Path(__file__).parents[2] / "docs" / "datasets.md").read_text(encoding="utf-8")
    assert [of.label for of in LABEL_FIELDS if f"`{of.label}`" not in page] == []
