"""Keys of the detector: its period, with which a time axis ends, and measured edges of a TDC's bins."""

from __future__ import annotations

import gzip
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import datagen as dg
from datagen.building.input_check import check_inputs
from datagen.config import config_from_mapping, load_config
from datagen.config.device import DeviceConfig, read_device
from datagen.detector import detector_for
from datagen.errors import InputError

pytestmark = pytest.mark.usefixtures("builds_here")


def settings(rate_mhz: Any, bins: int = 512) -> dict[str, Any]:
    return {
        "capture": {"scan": {"rows": 2, "columns": 2}, "time": {"bins": bins, "bin_width_ps": 100, "start_ns": 30}},
        "detector": {"repetition_rate_mhz": rate_mhz},
    }


@pytest.mark.parametrize("mode", ["ideal", "synchronous", "free_running"])
def test_a_longer_axis_is_refused_in_every_mode(mode: str) -> None:
    for rate, said in ((80, "= 80 with"), ({"uniform": [5, 80]}, "= 5 … 80 with")):
        values = settings(rate)
        values["detector"]["mode"] = mode
        with pytest.raises(dg.InputError, match=f"detector.repetition_rate_mhz {said}.*12.5 ns") as caught:
            config_from_mapping(values)
        assert "\n" not in str(caught.value)
    # What it allows is taken; the axis may begin at any time.
    config_from_mapping(settings(rate, bins=125))
    config_from_mapping(settings(19.53125))


def test_a_rate_that_is_left_out_makes_room() -> None:
    """Such as for recorded captures, whose laser nobody names."""
    config = config_from_mapping(settings(None, bins=4096))
    _, exposure = detector_for(config.detector, 0, 0, config.capture.time.axis())
    assert exposure.period_s == pytest.approx(409.6e-9)


def test_devices_likewise() -> None:
    device = read_device("vl53l1x", DeviceConfig).model_dump(mode="json")
    with pytest.raises(dg.InputError, match=r"device.*counting\.repetition_rate_mhz = 80 with time: .*12\.5 ns"):
        values = device | {"counting": device["counting"] | {"repetition_rate_mhz": 80}}
        config_from_mapping({"capture": {"device": values}})
    with pytest.raises(dg.InputError, match=r"detector\.repetition_rate_mhz = 80 with capture\.time"):
        config_from_mapping({"capture": {"device": "vl53l1x"}, "detector": {"repetition_rate_mhz": 80}})


REAL = Path(__file__).resolve().parents[3] / "shared" / "real" / "linospad2_tdc.csv.gz"
EDGES = [[0.0, 0.0, 30.25, 300.0], [0.0, 150.5, 150.5, 300.0]]
TABLE = ",0,1,2\n0,0.0,30.25,300.0\n1,,,\n2,150.5,150.5,300.0\n"
SMALL = """\
scenes: 1
capture: {{scan: {{rows: 1, columns: 2}}, time: {{bins: 64, bin_width_ps: {width}}}}}
detector: {{mode: free_running, tdc_edges_ps: {edges}}}
transport: {{samples: 4}}
"""


def written(folder: Path, edges: Any, width: float = 100.0) -> dg.DatasetConfig:
    """The configuration of a file in a folder."""
    (folder / "small.yaml").write_text(SMALL.format(edges=edges, width=width))
    return load_config(folder / "small.yaml")


def test_every_kind_of_file_gives_the_same_edges(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A table with a head has the ends of codes, and a row without numbers is left out; paths start at the
    configuration's folder."""
    (tmp_path / "codes.csv").write_text(TABLE)
    (tmp_path / "codes.csv.gz").write_bytes(gzip.compress(TABLE.encode()))
    (tmp_path / "edges.csv").write_text("\n".join(",".join(map(str, row)) for row in EDGES))
    np.savez(tmp_path / "edges.npz", edges_ps=np.array(EDGES))
    monkeypatch.chdir("/")
    for edges in ("codes.csv", "codes.csv.gz", "edges.csv", "edges.npz", EDGES):
        config = written(tmp_path, edges)
        assert config.detector.tdc_edges_ps == tuple(map(tuple, EDGES))
        spad, _ = detector_for(config.detector, 0, 0)
        assert spad.tdc_edges_s is not None
        np.testing.assert_allclose(spad.tdc_edges_s, 1e-12 * np.array(EDGES), rtol=1e-12)
        check_inputs(config)
    assert written(tmp_path, EDGES[1]).detector.tdc_edges_ps == (tuple(EDGES[1]),)


def test_a_stored_configuration_holds_the_edges(tmp_path: Path) -> None:
    """It is read again, with the same fingerprint, when the file is gone."""
    (tmp_path / "codes.csv").write_text(TABLE)
    config = written(tmp_path, "codes.csv")
    (tmp_path / "codes.csv").unlink()
    stored = json.loads(json.dumps(config.model_dump(mode="json")))
    again = config_from_mapping(stored, look_for_files=False)
    assert again == config and again.fingerprint() == config.fingerprint()
    assert written(tmp_path, EDGES[0]).fingerprint() != config.fingerprint()


def test_bins_without_width_stay_empty(tmp_path: Path) -> None:
    """All of a dataset's counts lie in bins that the TDC has."""
    dg.build(written(tmp_path, EDGES[1]), tmp_path / "made", progress=False)
    counts = dg.TransientDataset(tmp_path / "made", ("histogram",))[0]["histogram"].numpy().reshape(-1, 64)
    assert counts.sum() > 0 and (counts[:, 1::3] == 0).all()


def test_wrong_edges_are_refused_in_a_line(tmp_path: Path) -> None:
    (tmp_path / "words.csv").write_text("0,one,300\n")
    (tmp_path / "empty.csv").write_text("")
    (tmp_path / "late.csv").write_text("1,2,3\n")
    (tmp_path / "broken.csv.gz").write_text(TABLE)
    (tmp_path / "edges.txt").write_text("0,300\n")
    np.savez(tmp_path / "other.npz", edges=np.array(EDGES))
    for given, named in (
        ("none.csv", "none.csv: no such file"),
        ("edges.txt", "its suffix"),
        ("words.csv", "words.csv: holds no edges"),
        ("empty.csv", "empty.csv: shape"),
        ("late.csv", "late.csv.0. = .1, 2, …, 3.: edges must start at 0"),
        ("broken.csv.gz", "broken.csv.gz: holds no edges"),
        ("other.npz", "edges_ps"),
        ([[0, 200, 100]], "never descend"),
        (7, "edge"),
        (f"{EDGES[0]}, tdc_dnl: 0.2", "tdc_edges_ps and tdc_dnl"),
        (f"{EDGES[0]}, tdc_period_bins: 30", "tdc_edges_ps and tdc_period_bins"),
    ):
        with pytest.raises(InputError, match=named) as refused:
            written(tmp_path, given)
        assert "detector" in str(refused.value) and "\n" not in str(refused.value)
    with pytest.raises(InputError, match="3 bins end at"):
        check_inputs(written(tmp_path, EDGES, width=90.0))


@pytest.mark.skipif(not REAL.is_file(), reason=f"needs the measured edges of a LinoSPAD2's TDCs, {REAL.name}")
def test_the_catalogue_s_linospad2_takes_its_measured_edges() -> None:
    """Its bins are stated to 17.857 ps, and 140 of them are 2.5 ns."""
    settings = {"capture": {"device": "linospad2"}, "detector": {"tdc_edges_ps": REAL.name}}
    config = config_from_mapping(settings, base_directory=REAL.parent)
    check_inputs(config)
    widths = np.diff(config.detector.tdc_edges_ps)  # type: ignore[arg-type]
    assert widths.shape == (253, 140) and widths.std() / widths.mean() == pytest.approx(0.94, abs=0.01)
