"""The table of layouts: how the files of each public data set and program are recognised, and what reads them.

A layout is recognised by the names of its variables and the number of axes of the one with counts or light; the first
that fits a file reads it. Its function returns what is there as a `Captured`. What a file does not say, an option
states; an option that states what the layout says itself is refused.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from datagen.errors import InputError
from datagen.formats import tal, zaragoza
from datagen.formats.containers import (
    ALONE,
    ONE,
    POINTS,
    VALUES,
    Content,
    hdf5_content,
    matlab_content,
    numpy_content,
)
from datagen.formats.grids import OF_GRIDS, read_array, read_grid, read_netf
from datagen.formats.lists import read_consumer, read_convolutional, read_fermat, read_pairs
from datagen.formats.recording import Captured, Stated
from datagen.records.checks import as_given, option


@dataclass(frozen=True)
class Layout:
    """One layout.

    name : what it is, for people. values : the variable of counts or light, or the structure that holds it. beside :
    other variables that a file must have. axes : the numbers of axes that `values` may have; empty: any. wanted :
    name → the most numbers of a variable that is read. options : the options that it has a use for, beside `--bin`,
    which is compared with the file, and `--bins`. read : its function.
    """

    name: str
    values: str
    beside: tuple[str, ...]
    axes: tuple[int, ...]
    wanted: Mapping[str, int]
    read: Callable[[Content, Stated], Captured]
    options: tuple[str, ...] = ()

    def fits(self, content: Content) -> bool:
        """Whether a file has this layout, by the names and shapes of its variables."""
        if not {self.values, *self.beside} <= {*content.names}:
            return False
        shape = content.shapes[self.values]
        return shape is None or not self.axes or len(shape) in self.axes


def _refuse(content: Content, stated: Stated, why: str) -> Captured:
    """Raise `InputError` for a layout that is known, and holds nothing that can be imported as it is."""
    raise InputError(f"{content.path}: {why.format(variable=as_given('variable', 'data_t'))}")


_GRID_OPTIONS = ("wall", "axes", "tof", "laser", "points")
_OF_PAIRS = {"camera_points": POINTS, "laser_points": POINTS, "camera_normals": POINTS, "laser_normals": POINTS,
             "bin_resolution": ONE}  # fmt: skip
_OF_NLOSDATA = {"NLOSDATA.transient": VALUES, "NLOSDATA.l": POINTS, "NLOSDATA.times": POINTS,
                "NLOSDATA.is_confocal": ONE}  # fmt: skip
_OF_FERMAT = {"transients": VALUES, "temporalBinCenters": VALUES, "detLocs": POINTS, "srcLoc": POINTS,
              "whetherConfocal": ONE}  # fmt: skip
_OF_NETF = {"data": VALUES, "wall_size": 2, "time_bin": ONE, "deltaT": ONE}

LAYOUTS = (
    Layout("y-tal", "H", ("H_format",), (), tal.WANTED, tal.read_tal),
    Layout("Zaragoza NLOS dataset", "data", ("cameraGridPositions", "laserGridPositions", "deltaT", "t0"),
           (5, 7), zaragoza.WANTED, zaragoza.read_zaragoza),
    Layout("Zaragoza NLOS dataset, as NeTF makes it over", "data", ("cameraGridPositions", "deltaT"), (3,),
           zaragoza.WANTED, zaragoza.read_made_over),
    Layout("NeTF, measured", "data", ("wall_size", "time_bin"), (3,), _OF_NETF,
           partial(read_netf, axes="tyx", bin_width="time_bin"), ("axes",)),
    Layout("NeTF, simulated", "data", ("wall_size", "deltaT"), (3,), _OF_NETF,
           partial(read_netf, axes="xyt", bin_width="deltaT"), ("axes",)),
    Layout("f-k migration", "meas", (), (), {"meas": VALUES, **OF_GRIDS},
           lambda content, stated: read_grid(content, "meas", "yxt", stated, counts_from_laser=True), _GRID_OPTIONS),
    Layout("light-cone transform", "rect_data", (), (), {"rect_data": VALUES, **OF_GRIDS},
           lambda content, stated: read_grid(content, "rect_data", "xyt", stated, counts_from_laser=False),
           _GRID_OPTIONS),
    Layout("pairs of points", "trans_data", (), (), {"trans_data": VALUES, **_OF_PAIRS}, read_pairs),
    Layout("convolutional approximations", "NLOSDATA", (), (), _OF_NLOSDATA, read_convolutional,
           ("laser",)),
    Layout("Fermat paths", "transients", ("detLocs", "temporalBinCenters"), (2,), _OF_FERMAT, read_fermat,
           ("laser",)),
    Layout("consumer NLOS", "hists", ("pt_cloud",), (), {"hists": VALUES, "pt_cloud": POINTS},
           read_consumer),
    Layout("phasor fields of 2020", "u_total", ("omega_space",), (), {}, partial(
        _refuse, why="holds a field at some frequencies (u_total, omega_space), from which counts over time cannot "
        "be had; take the histograms that it was made of")),
    Layout("y-tal of NLOS-DIRAC", "data_t", ("offset_laser", "offset_camera"), (), {}, partial(
        _refuse, why="is of NLOS-DIRAC, and says not where laser and sensor stood, which y-tal guesses; state wall, "
        "times and laser of its array by options, beginning with {variable}")),
)  # fmt: skip
"""All layouts, in the order in which they are tried."""


def read_capture(path: Path, format: str, stated: Stated) -> tuple[Captured, str]:
    """What one file holds, and the name of its layout.

    format : "tal" (HDF5), "mat" or "numpy". Raises `InputError`, one line, for a file that is damaged, of no layout
    that is known, or lacks something that no option states.
    """
    container = {"tal": hdf5_content, "mat": matlab_content, "numpy": numpy_content}[format]
    variable = stated.options.variable
    seen = container(path, {})
    layout = _layout(seen, variable)
    if layout is None:
        raise InputError(_unknown(seen, format))
    _refuse_options(path, layout, stated)
    return layout.read(container(path, layout.wanted), stated), layout.name


def _unknown(content: Content, format: str) -> str:
    """What is said of a file of no layout that is known, with the options that may help."""
    # Most likely the largest one is meant.
    largest = max(content.shapes.items(), key=lambda item: math.prod(item[1] or (0,)), default=("data", ()))[0]
    known = ", ".join(sorted({layout.values for layout in LAYOUTS}))
    frames = f"; frames of a sensor need {as_given('device', 'tmf8820')}" if format == "numpy" else ""
    return (
        f"{content.path}: has {content.listed}: of no known layout ({known}); name the array of a grid: "
        f"{as_given('variable', largest)}{frames}"
    )


def _layout(content: Content, variable: str | None) -> Layout | None:
    """The layout of a file; that of an array alone where the options name it, or the file has no names."""
    if variable is None and content.names != (ALONE,):
        return next((layout for layout in LAYOUTS if layout.fits(content)), None)
    name = variable or ALONE
    if name not in content.names:
        raise InputError(f"{content.path}: {as_given('variable', name)}: it has {content.listed}")
    options = (*_GRID_OPTIONS, "variable", "start")
    return Layout("an array", name, (), (), {name: VALUES, "tofgrid": POINTS}, read_array, options)


def _refuse_options(path: Path, layout: Layout, stated: Stated) -> None:
    """Raise `InputError` for an option that states what the layout says itself."""
    options = stated.options
    given = {
        "wall": options.wall_m, "axes": options.axes, "tof": options.delays, "laser": options.laser,
        "points": options.points, "start": options.start_ns,
    }  # fmt: skip
    for name, value in given.items():
        if value is not None and name not in layout.options:
            raise InputError(f"{option(name)}: {path} says it itself ({layout.name}); leave the option out")
