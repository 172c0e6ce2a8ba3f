"""Other tools open a dataset: xarray, pandas and other Parquet readers, mlcroissant."""

from __future__ import annotations

import json
import re
import shutil
import warnings
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml
import zarr
from datasets import write_dataset
from fake_samples import fake_sample, sequence_config, small_config

import datagen as dg
from datagen.config import DatasetConfig, load_config, stored_axes, time_axes
from datagen.config.store import StoredField
from datagen.errors import InputError
from datagen.store import Description, committed_records, read_manifest, schema_of, verify
from datagen.store.card import card as card_text
from datagen.store.schema import FORMAT

ROOT = Path(__file__).resolve().parents[2]
EVERY_FIELD = list(get_args(StoredField))
TIME = {"bins": 16, "bin_width_ps": 250.0, "start_ns": 3.0, "origin": "source"}
SCAN = {"rows": 2, "columns": 3}
CAPTURES: dict[str, dict[str, Any]] = {
    "confocal": {"pairing": "confocal", "scan": SCAN, "time": TIME},
    "exhaustive": {"pairing": "exhaustive", "scan": SCAN, "field_of_view": {"rows": 2, "columns": 2}, "time": TIME},
    "flood": {
        "pairing": "exhaustive", "illumination": "flood", "scan": {"rows": 2, "columns": 4},
        "field_of_view": {"rows": 2, "columns": 2}, "time": TIME,
    },
}  # fmt: skip
CAPTURES["sequence"] = CAPTURES["confocal"]


def everything(capture: str) -> DatasetConfig:
    contents = [{"kind": "box", "count": 2}, {"kind": "library", "classes": ["chair"]}]
    made_of, fields = sequence_config, EVERY_FIELD
    if capture != "sequence":
        made_of, fields = small_config, [name for name in EVERY_FIELD if name != "moving_transient"]
    return made_of(
        scene={"contents": contents}, capture=CAPTURES[capture],
        labels={"rows": 6, "columns": 8, "voxels": [4, 5, 7]},
        store={"fields": fields, "scenes_per_shard": 4},
    )  # fmt: skip


@pytest.fixture(scope="module", params=CAPTURES)
def dataset(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_dataset(everything(request.param), tmp_path_factory.mktemp("elsewhere") / "set", fake_sample)


def test_a_name_of_an_axis_has_one_size() -> None:
    """In every ready configuration, with all fields."""
    ready = [load_config(path) for path in sorted((ROOT / "configs").glob("*.yaml"))]
    for config in [everything(capture) for capture in CAPTURES] + [
        config.model_copy(update={"store": config.store.model_copy(update={"fields": tuple(EVERY_FIELD)})})
        for config in ready
    ]:
        sizes = {axis: {time.bins} for axis, time in time_axes(config).items()}
        if config.sequence is not None:
            sizes["frame"] = {config.sequence.frames}
        schema = schema_of(config)
        for field in schema.fields:
            for name, size in zip(field.dims, (schema.scenes, *field.shape), strict=True):
                sizes.setdefault(name, set()).add(size)
        assert all(len(of) == 1 for of in sizes.values()), (config.name, sizes)
        assert not sizes.keys() & schema.by_name.keys(), "a field of many axes is no coordinate"


def test_a_group_is_opened_in_one_read(dataset: Path) -> None:
    """The group's metadata hold those of all arrays, as zarr itself would write them."""
    ours = dataset / "data.zarr/zarr.json"
    theirs = shutil.copytree(dataset, dataset.with_name("theirs"), dirs_exist_ok=True) / "data.zarr/zarr.json"
    with pytest.warns(UserWarning, match="not part in the Zarr format 3 specification"):
        zarr.consolidate_metadata(theirs.parent)
    assert json.loads(ours.read_bytes()) == json.loads(theirs.read_bytes())
    named = {name for name, _ in zarr.open_consolidated(dataset / "data.zarr", mode="r").arrays()}
    manifest = read_manifest(dataset)
    assert named == {*stored_axes(manifest.parsed_config()), *manifest.schema.by_name}


def test_xarray_opens_it(dataset: Path) -> None:
    xarray = pytest.importorskip("xarray", reason="xarray is not installed (extra `tests`)")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        opened = xarray.open_zarr(dataset / "data.zarr", chunks=None)
    manifest = read_manifest(dataset)
    schema, frames = manifest.schema, () if manifest.frames is None else ("frame",)
    assert opened.histogram.dims == ("scene", *frames, "laser", "pixel", "bin")
    assert opened.histogram.dtype == np.uint16
    assert "_FillValue" not in opened.histogram.encoding | opened.histogram.attrs
    assert opened.histogram.attrs["units"] == "counts" and opened.depth.attrs["units"] == "m"
    assert all(of.attrs["units"] and of.attrs["long_name"] for of in opened.variables.values())
    assert opened.bin.dims == ("bin",) and opened.bin.attrs["units"] == "ps"
    assert np.array_equal(opened.bin, 3125.0 + 250.0 * np.arange(16))
    assert "laser emission" in opened.bin.attrs["long_name"]
    points = {f"{device}_{what}" for device in ("laser", "sensor") for what in ("points", "normals", "position")}
    assert {"bin", "sensor_pixels", "relay_wall", *points} <= set(opened.coords)
    assert set(opened.data_vars) | set(opened.coords) == {"bin", *frames, *schema.by_name}
    data = dg.TransientDataset(dataset, tuple(schema.by_name), counts="stored")
    for name in schema.by_name:
        assert opened[name].dtype == schema.by_name[name].dtype
        assert np.array_equal(opened[name][5].values, data[5][name].numpy()), name
    early = opened.histogram.sel(bin=slice(0, 4000)).isel(scene=2).sum("bin")
    assert np.array_equal(early, data[2]["histogram"].numpy()[..., :4].sum(-1, dtype=np.int64))


@pytest.mark.filterwarnings("ignore::DeprecationWarning:rdflib", "ignore::DeprecationWarning:mlcroissant")
def test_mlcroissant_opens_it_without_a_warning(dataset: Path) -> None:
    mlcroissant = pytest.importorskip("mlcroissant", reason="mlcroissant is not installed")
    opened = mlcroissant.Dataset(jsonld=str(dataset / "croissant.json"))
    assert not opened.metadata.ctx.issues.errors and not opened.metadata.ctx.issues.warnings
    scenes, arrays = (list(opened.records(name)) for name in ("scenes", "arrays"))
    assert [row["scenes/scene"] for row in scenes] == list(range(12))
    assert {row["scenes/split"] for row in scenes} <= {b"train", b"val", b"test"}
    assert [row["arrays/name"] for row in arrays] == list(read_manifest(dataset).schema.by_name)


def test_cards_for_people_and_machines_are_whole(tmp_path: Path) -> None:
    config = everything("confocal")
    for terms, hub, page in (
        ("CC-BY-4.0", "cc-by-4.0", "https://spdx.org/licenses/CC-BY-4.0.html"),
        ("https://example.org/terms", "other", "https://example.org/terms"),
        ("", None, "no-permission"),
    ):
        named = config.model_copy(update={"license": terms, "name": 'a "name": with # marks'})
        path = write_dataset(named, tmp_path / "set", fake_sample)
        _, front, text = (path / "README.md").read_text().split("---\n", 2)
        card, machines = yaml.safe_load(front), json.loads((path / "croissant.json").read_text())
        assert card.get("license") == hub and page in machines["license"]
        assert card["pretty_name"] == named.name and text.startswith("\n# a ")
        assert card["configs"] == [{"config_name": "scenes", "data_files": "samples.parquet"}]
    assert machines["version"] == f"{FORMAT}.12.0" and verify(path).problems == ()
    for file_set in machines["distribution"][1:]:
        assert list(path.glob(file_set["includes"].removesuffix("**") + "zarr.json")), file_set["@id"]
    described = {row["arrays/name"]: row["arrays/shape"] for row in machines["recordSet"][1]["data"]}
    group = zarr.open_group(path / "data.zarr", mode="r")
    assert {name: ", ".join(map(str, array.shape)) for name, array in group.arrays() if name != "bin"} == described
    assert all(
        machines[f"rai:{name}"] for name in ("dataCollection", "dataBiases", "dataLimitations", "dataUseCases")
    )
    found = pq.read_table(path / "samples.parquet", filters=[("split", "==", "train")], columns=["scene"])
    assert found["scene"].to_pylist() == dg.TransientDataset(path, split="train").scenes.tolist()
    (path / "build/shard-000001.json").unlink()
    manifest = read_manifest(path)
    rest = Description(manifest, committed_records(path, manifest))
    assert "configs" not in yaml.safe_load(card_text(rest).split("---\n", 2)[1])


def test_any_name_is_cited_by_an_entry_that_bibtex_reads(tmp_path: Path) -> None:
    for name, key in (
        ("letters", "letters"), ("Türme & 50 % {Rauch}, 2. Teil", "Turme-50-Rauch-2.-Teil"),
        ("\\input{x}}, evil = {", "input-x-evil"), ("雨", "dataset"),
    ):  # fmt: skip
        path = write_dataset(small_config(scenes=1, name=name), tmp_path / key, fake_sample)
        cite = json.loads((path / "croissant.json").read_text())["citeAs"]
        entry = r"@misc\{([A-Za-z0-9._:-]+), title = \{([^{}]*)\}, year = \{\d+\}, note = \{[^{}]*\}\}"
        found = re.fullmatch(entry, cite)
        assert found is not None and found[1].replace("--", "-") == key
        assert not re.search(r"(?<!\\)[%&#$_]", found[2])


def test_terms_without_a_page_are_refused() -> None:
    for terms in ("CC BY 4.0", "free for all", "MIT AND ISC", "LicenseRef-mine", "://", "s3://a/b"):
        with pytest.raises(InputError, match=r"license: must be a name of the SPDX list .* or an address"):
            small_config(license=terms)
    assert small_config(license="cc-by-4.0").license == "CC-BY-4.0"
