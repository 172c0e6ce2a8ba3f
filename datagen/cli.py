"""The command line: every command parses, calls one function, prints. Heavy imports happen inside the commands."""

from __future__ import annotations

import importlib
import shlex
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NoReturn, cast

import click

from datagen._version import __version__
from datagen.errors import CheckError, as_line
from datagen.exit_status import CHANGED_NOTHING, GOES_ON, exit_with, guarded, if_ended, say

if TYPE_CHECKING:
    from datagen.devices import Comparison


@click.group(
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
)
@click.version_option(__version__, message="datagen %(version)s")
@click.pass_context
def cli(context: click.Context) -> None:
    """Datasets for machine learning on non-line-of-sight single-photon data."""
    _help_alone(context)


def _help_alone(context: click.Context) -> None:
    """Print the help of a group that is named without a command."""
    if context.invoked_subcommand is None:
        say(context.get_help())


@cli.command()
@click.argument("config")
@click.option("--scenes", type=int, help="Instead of the configuration's number of scenes.")
@click.option("--workers", type=int, default=1, show_default=True, help="Processes of the build, one core each.")
@click.option("--seconds", type=float, default=5.0, show_default=True, help="How long scenes are simulated.")
@click.option("--json", "json_path", help="Write the plan's numbers to this file, too.")
def plan(config: str, scenes: int | None, workers: int, seconds: float, json_path: str | None) -> None:
    """Check CONFIG and say what building it would make and take. A few scenes are simulated, nothing is built."""
    from datagen.building.plan_text import plan as make_plan
    from datagen.config import load_config

    settings = load_config(config)
    if scenes is not None:
        settings = settings.with_scenes(scenes)
    say(make_plan(settings, workers, seconds, json_path))


@cli.command()
@click.argument("sweep")
@click.option("--device", "name", required=True, help="What recorded it: a name of the catalogue, or a device file.")
@click.option("--out", required=True, help="The device file to write, .yaml.")
@click.option("--albedo", type=float, default=0.8, show_default=True, help="Of the plane.")
@click.option("--plane", help="What it is made of, instead: a file of one material, as compare --materials has it.")
@click.option("--nearest", type=float, default=0.12, show_default=True, help="Distance from which frames count, m.")
@click.option("--all", "everything", is_flag=True, help="Fit all frames, and keep none back for the test.")
@click.option("--picture", help="Draw fit and residuals into this file, .png.")
@click.option("--quiet", is_flag=True, help="No progress.")
def calibrate(
    sweep: str, name: str, out: str, albedo: float, plane: str | None, nearest: float, everything: bool,
    picture: str | None, quiet: bool,
) -> None:  # fmt: skip
    """Fit a sensor's numbers to SWEEP, its frames before a plane at known distances, and write them as a device."""
    from datagen.building.progress import Progress
    from datagen.devices import calibrate as fit
    from datagen.devices import device, read_frames, read_materials, write_device
    from datagen.errors import InputError

    _check_picture(picture)
    frames = read_frames(sweep)
    materials = [None] if plane is None else [*read_materials(plane).values()]
    if len(materials) != 1:
        raise InputError(f"--plane {plane}: holds {len(materials)} materials; leave the plane's alone in a file")
    with closing(Progress(not quiet)) as progress:
        found = fit(
            frames,
            device(name),
            albedo=albedo,
            held_out=not everything,
            nearest_m=nearest,
            plane=materials[0],
            doing=progress.doing,
        )
    say(found.text())
    write_device(found.device, out)
    if picture is not None:
        from datagen.report.device_plots import draw_calibration

        draw_calibration(found, picture)


@cli.command()
@click.argument("captures")
@click.argument("simulated", required=False, metavar="")
@click.option("--device", "name", help="What recorded CAPTURES: a name of the catalogue, or a device file.")
@click.option(
    "--mesh", "paths", multiple=True, help="What stood there, in metres, as the poses have it; may be repeated."
)
@click.option(
    "--fit",
    type=click.Choice(("hand", "mesh", "zones", "bounces", "angles")),
    multiple=True,
    show_default=True,
    default=("hand", "mesh", "bounces", "angles"),
    help="What is fitted besides albedos and a floor; may be repeated.",
)
@click.option("--fixed", is_flag=True, help="Fit albedos and a floor alone.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON, for programs.")
@click.option("--picture", help="Draw the best, median and worst histogram and the errors into this file, .png.")
@click.option("--out", help="Write the device as fitted into this file, .yaml.")
@click.option("--materials", help="Write what the surfaces are, as configurations have it, into this file, .yaml.")
@click.option("--quiet", is_flag=True, help="No progress.")
@click.pass_context
def compare(
    context: click.Context, captures: str, simulated: str | None, name: str | None, paths: tuple[str, ...],
    fit: tuple[Any, ...], fixed: bool, as_json: bool, picture: str | None, out: str | None, materials: str | None,
    quiet: bool,
) -> None:  # fmt: skip
    """Hold CAPTURES of a sensor at known poses against their simulation."""
    from datagen.errors import InputError

    if simulated is not None:
        given = {"--device": name, "--mesh": paths, "--out": out, "--materials": materials, "--fixed": fixed}
        if options := [option for option, value in given.items() if value]:
            raise InputError(f"{options[0]}: is not for two datasets; leave it out, or {simulated}")
        context.invoke(compare_datasets, recorded=captures, simulated=simulated, as_json=as_json, picture=picture)
        say("`datagen compare REAL SIMULATED` is now `datagen compare-datasets REAL SIMULATED`", err=True)
        return
    if name is None or not paths:
        raise InputError(
            "compare: give CAPTURES with --device and --mesh; two datasets: datagen compare-datasets REAL SIMULATED"
        )

    from datagen.building.progress import Progress
    from datagen.devices import compare as held_against
    from datagen.devices import device, read_frames, read_parts, write_device, write_materials
    from datagen.devices.material_files import check_materials_file

    _check_picture(picture)
    if materials is not None:
        check_materials_file(materials)
    groups = () if fixed else fit
    frames, parts = read_frames(captures), read_parts(paths)
    with closing(Progress(not quiet)) as progress:
        found = held_against(frames, device(name), parts, fit=groups, doing=progress.doing)
    _tell_comparison(found, as_json, picture)
    if out is not None and found.device is not None:
        write_device(found.device, out)
    if materials is not None:
        write_materials(found.materials, materials)


@cli.command("compare-datasets")
@click.argument("recorded")
@click.argument("simulated")
@click.option("--json", "as_json", is_flag=True, help="Print JSON, for programs.")
@click.option("--picture", help="Draw the best, median and worst histogram and the errors into this file, .png.")
def compare_datasets(recorded: str, simulated: str, as_json: bool, picture: str | None) -> None:
    """Hold the histograms of the dataset RECORDED against those of SIMULATED, scene by scene."""
    from datagen.devices import compare_datasets as held_against

    _check_picture(picture)
    _tell_comparison(held_against(recorded, simulated), as_json, picture)


def _check_picture(picture: str | None) -> None:
    """Find a wrong name of a picture before the work, and before other files are written."""
    if picture is not None:
        from datagen.report.style import check_png

        check_png(picture, "picture")


def _tell_comparison(found: Comparison, as_json: bool, picture: str | None) -> None:
    """Print a comparison, and draw it where a picture is asked for."""
    import json

    say(json.dumps(found.as_dict(), indent=1) if as_json else found.text())
    if picture is not None:
        from datagen.report.device_plots import draw_comparison

        draw_comparison(found, picture)


@cli.command()
@click.argument("names", nargs=-1)
@click.option(
    "--sheet", "out", help="Instead: draw into this file, .png, what they see of one room, and print a table."
)
def device(names: tuple[str, ...], out: str | None) -> None:
    """Print all numbers of devices NAMES (of the catalogue, or files), each with its source; left out: the
    catalogue."""
    from datagen.config.device import DeviceConfig, device_names, read_device

    if out is not None:
        from datagen.devices import device as named
        from datagen.report.device_sheet import device_sheet

        say(device_sheet([named(name) for name in names or device_names()], out))
        return
    for name in names:
        say(str(read_device(name, DeviceConfig)))
    if not names:
        say("\n".join(f"{name:14} {read_device(name, DeviceConfig).description}" for name in device_names()))


@cli.command()
@click.argument("config")
@click.argument("path", metavar="OUT")
@click.option("--scenes", type=int, help="Instead of the configuration's number; a dataset may grow.")
@click.option("--workers", type=int, default=1, show_default=True, help="Processes, one core each.")
@click.option("--shards", help="Only these shards, such as 0-99 or 3,7-9 (for job arrays).")
@click.option("--engine", default="local", show_default=True, help="local or dask.")
@click.option("--scheduler", help="Address of a Dask scheduler; left out: a cluster on this machine.")
@click.option(
    "--accept-mixed", is_flag=True, help="Go on where other library versions or another architecture began."
)
@click.option(
    "--scene-seconds",
    help="Give a scene up that takes longer (local workers): seconds, or `forecast`.",
)
@click.option("--quiet", is_flag=True, help="No progress.")
def build(config: str, path: str, quiet: bool, **options: Any) -> None:
    """Build the dataset that CONFIG describes in the folder OUT. Running it again resumes."""
    if_ended(GOES_ON)
    from datagen.building.engines import start_imports
    from datagen.building.progress import Progress
    from datagen.config import load_config

    settings = load_config(config)
    with closing(Progress(not quiet)) as progress:
        # Imports take seconds.
        progress.doing("starting")
        # Workers import beside this process, and only once the configuration has been found to be readable.
        if options["engine"] == "local":
            start_imports("datagen.building.build", "datagen.pipeline")
        from datagen.building.build import build as build_dataset

        if options["scene_seconds"] is not None:
            from datagen.building.plan import scene_limit

            options["scene_seconds"] = scene_limit(options["scene_seconds"], settings)
    result = build_dataset(settings, path, progress=not quiet, **options)
    if quiet and result.noisy:
        say(as_line(result.noisy), err=True)
    say(as_line(result.summary()))
    if result.complete and not quiet:
        # Scenes of an object store are not drawn.
        draw = f"; datagen show {shlex.quote(path)} 0" if isinstance(result.path, Path) else ""
        say(as_line(f"next: datagen info {shlex.quote(path)}{draw}"), err=True)


@cli.command()
@click.argument("dataset")
@click.option("--deep", is_flag=True, help="Decode every value, too, and compare it with its digest.")
@click.option(
    "--resimulate", type=click.IntRange(1), metavar="N", help="Make N random scenes again, as `replay` does."
)
def verify(dataset: str, deep: bool, resimulate: int | None) -> None:
    """Check every file of DATASET against the hashes in its commit records."""
    if_ended(CHANGED_NOTHING)
    from datagen.store import verify as verify_dataset
    from datagen.store.card import readable

    found = verify_dataset(dataset, deep)
    problems, again = [*found.problems], ""
    # Said before scenes are made again: that takes long, and ends where a mesh file is gone.
    for problem in problems:
        say(as_line(problem))
    if resimulate is not None:
        from datagen.building.resimulate import resimulate as simulate_again

        scenes, differing = simulate_again(dataset, resimulate)
        for problem in differing:
            say(as_line(problem))
        problems += differing
        again = f"; scenes simulated again: {', '.join(map(str, scenes))}"
    if problems:
        raise CheckError(f"{dataset}: {len(problems)} problems; build it again to mend them")
    state = f"{found.scenes} scenes in {found.shards} shards, {readable(found.bytes)}: all as written{again}"
    say(as_line(f"{dataset}: {state}"))


@cli.command()
@click.argument("dataset")
def digest(dataset: str) -> None:
    """Print one hash of all values of DATASET, the same however it was built and stored."""
    if_ended(CHANGED_NOTHING)
    from datagen.store.verify import dataset_digest

    say(dataset_digest(dataset))


@cli.command()
@click.argument("dataset")
def info(dataset: str) -> None:
    """Say what DATASET holds and how its build went."""
    if_ended(CHANGED_NOTHING)
    from datagen.store.info import info as describe

    say(describe(dataset))


@cli.command()
@click.argument("dataset")
@click.argument("index", type=int)
@click.option("--out", help="Folder for the pictures; left out: DATASET.show beside the dataset.")
def show(dataset: str, index: int, out: str | None) -> None:
    """Draw scene INDEX of DATASET: room with light by part, counts, labels, scan."""
    from datagen.report.pages import show as draw

    for picture in draw(dataset, index, out):
        say(as_line(str(picture)))
    # On standard error, so that standard output has paths alone.
    then = f"next: datagen preview {shlex.quote(dataset)}; README (Train on it; Track somebody) trains networks"
    say(as_line(then), err=True)


@cli.command()
@click.argument("dataset")
@click.argument("scene", type=int)
def replay(dataset: str, scene: int) -> None:
    """Make scene SCENE of DATASET again, compare it field by field, and name the stage where it first differs."""
    if_ended(CHANGED_NOTHING)
    from datagen.building.replay import replay_comparison

    found = replay_comparison(dataset, scene)
    say(found.text())
    problem = found.problem()
    if problem is not None:
        raise CheckError(problem)


@cli.command()
@click.argument("dataset")
@click.option("--out", help="The HTML file; left out: DATASET.html beside the dataset.")
@click.option("--scenes", type=int, default=3, show_default=True, help="Scenes shown in full.")
def preview(dataset: str, out: str | None, scenes: int) -> None:
    """Put DATASET on one HTML page: state, rooms, what varies, a few scenes."""
    from datagen.report.preview import preview as make_page

    say(as_line(str(make_page(dataset, out, scenes))))


@cli.command()
@click.argument("configs", nargs=-1, required=True)
@click.argument("out")
@click.option("--rooms", type=int, default=64, show_default=True, help="How many rooms, shared by the CONFIGS.")
@click.option("--labels", type=int, help="Instead: so many rooms, each beside all its labels.")
def sheet(configs: tuple[str, ...], out: str, rooms: int, labels: int | None) -> None:
    """Draw the first rooms of CONFIGS, plan and 3D, as one picture OUT; no light is simulated."""
    from datagen.config import load_config
    from datagen.report.contact_sheet import contact_sheet, label_sheet

    settings = [load_config(config) for config in configs]
    say(contact_sheet(settings, rooms, out) if labels is None else label_sheet(settings, labels, out))


@cli.command()
@click.argument("out")
@click.option("--config", help="Another room, with one laser point and one pixel; left out: the paper's.")
@click.option("--quick", is_flag=True, help="Few rays and pixels: seconds instead of minutes.")
@click.option("--quiet", is_flag=True, help="No progress.")
def reproduce(out: str, config: str | None, quick: bool, quiet: bool) -> None:
    """Compute the paper's figures, as printed and radiometrically, into the folder OUT: a page and all numbers."""
    from datagen.paper.reproduce import reproduce as write

    say(write(out, config, quick, (lambda stage: None) if quiet else (lambda stage: say(stage, err=True))))


@cli.command()
@click.argument("name", required=False)
@click.argument("path", metavar="[OUT]", required=False)
@click.option("--workers", type=int, default=1, show_default=True, help="Processes, one core each.")
@click.option("--quiet", is_flag=True, help="No progress.")
def suite(name: str | None, path: str | None, workers: int, quiet: bool) -> None:
    """Build the benchmark set NAME in the folder OUT; without either, list the sets."""
    if_ended(GOES_ON)
    from datagen.suites.catalogue import find_suite, listing

    if name is None:
        say(listing())
        return
    find_suite(name)
    if path is None:
        raise click.UsageError("missing argument 'OUT'", click.get_current_context())
    from datagen.suites.building import build_suite

    say(build_suite(name, path, workers, progress=not quiet).summary())


@cli.command()
@click.argument("suite")
@click.argument("predictions")
@click.option("--split", default="test", show_default=True, help="Scenes that are scored.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON, for programs.")
def score(suite: str, predictions: str, split: str, as_json: bool) -> None:
    """Compare PREDICTIONS, an .npz file or a Zarr group, with the labels of SUITE, the folder of a benchmark set."""
    if_ended(CHANGED_NOTHING)
    from datagen.scoring.scores import score as scored

    scores = scored(suite, predictions, split)
    say(scores.json() if as_json else scores.table())


@cli.command()
@click.argument("method")
@click.argument("suite")
@click.argument("out")
@click.option("--split", default="test", show_default=True, help="Scenes that are predicted.")
@click.option("--seed", type=int, default=0, show_default=True, help="Seed of the training.")
def baseline(method: str, suite: str, out: str, split: str, seed: int) -> None:
    """Predict SUITE by METHOD (mean, backprojection or network; of sequences mean, tracking or network) into the file
    OUT, which `datagen score` reads."""
    from datagen.baselines import write_baseline

    say(write_baseline(method, suite, out, split, seed))


@cli.command()
@click.argument("dataset")
@click.argument("out")
@click.option("--format", "form", required=True, help="tal (y-tal), mat (MATLAB), npz, h5, glb or hub.")
@click.option("--scenes", help="Only these, such as 0,3-5; left out: all.")
@click.option(
    "--field", help="Field of tal and mat files: histogram, transient, background_…; left out: the first stored."
)
@click.option("--frame", type=int, help="Of sequences only this frame, in tal, mat and glb files; left out: each.")
def export(
    dataset: str, out: str, form: str, scenes: str | None, field: str | None, frame: int | None
) -> None:  # fmt: skip
    """Write scenes of DATASET into the folder OUT as files that other programs read."""
    if_ended("files that are finished stay, the same command writes all of them again")
    from datagen.formats import export as write

    for path in write(dataset, out, form, scenes, field, frame):
        say(as_line(str(path)))


@cli.command("import")
@click.argument("files", nargs=-1, required=True)
@click.argument("path", metavar="OUT")
@click.option("--format", "form", help="tal (HDF5), mat (MATLAB), numpy or frames; left out: by the suffix.")
@click.option("--bin", "bin_width", help="Width of a time bin where a file does not say it: 4ps, or 3mm of path.")
@click.option("--wall", help="Size of the scanned grid where a file does not say it: 2m, or 2m x 150cm.")
@click.option("--tof", help="File with tofgrid for a meas file without it; none: it has been subtracted.")
@click.option("--axes", help="Order of the axes of a grid, such as txy; also f (frames) and c (channels).")
@click.option("--bins", type=int, help="Keep so many of the first time bins.")
@click.option("--field", help="histogram or transient; left out: histogram where all values are whole.")
@click.option("--variable", help="The array of a grid, in a file of no layout that is known.")
@click.option("--laser", help="confocal, or the one laser point as x,y,z (m), where a file does not say it.")
@click.option("--points", help="File with the places of the points: grid_points, pos, or z_offset and width.")
@click.option("--start", help="When the first bin begins where a file does not say it: 0ns, or 1.2m of path.")
@click.option("--device", help="What recorded frames of a sensor: a name of the catalogue, or a device file.")
@click.option("--places", help="Places of what is hidden: tag1_positions.json of DENALI.")
@click.option("--name", default="imported", show_default=True, help="Name of the dataset, on its cards.")
@click.option("--description", default="", help="What was measured, and how.")
@click.option("--license", default="", help="What others may do with it: an SPDX name, or an address.")
@click.option("--quiet", is_flag=True, help="No progress.")
def import_files(files: tuple[str, ...], path: str, form: str | None, quiet: bool, **options: Any) -> None:
    """Make a dataset OUT of captures of other programs or of a laboratory, a scene for each of FILES, or
    for each frame in files of a sensor of zones."""
    if_ended(GOES_ON)
    from datagen.formats import import_captures

    result = import_captures(files, path, format=form, progress=not quiet, **options)
    say(as_line(result.summary()))


class _Benches(click.Group):
    """Benchmarks, each imported only when it runs."""

    MODULES: ClassVar[dict[str, str]] = {
        "accuracy": "What accuracy costs in time: error against seconds for everything that can be chosen.",
        "stages": "Where a build's time goes, and scenes per second on 1 and 2 workers.",
    }

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(self.MODULES)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in self.MODULES:
            return None
        return cast(click.Command, importlib.import_module(f"datagen.bench.{cmd_name}").main)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        # From `MODULES`, so that the list imports no bench.
        with formatter.section("Commands"):
            formatter.write_dl(list(self.MODULES.items()))


@cli.group(cls=_Benches, invoke_without_command=True)
@click.pass_context
def bench(context: click.Context) -> None:
    """Measure speed; tables name the machine."""
    _help_alone(context)


@cli.command()
def schema() -> None:
    """Print the JSON Schema of configuration files, for editors."""
    import json

    from datagen.config import json_schema

    say(json.dumps(json_schema(), indent=2, ensure_ascii=False))


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Entry point: run a command and exit with its status."""
    exit_with(lambda: run(arguments))


def run(arguments: Sequence[str] | None = None) -> int:
    """Run a `datagen` command; returns the exit status."""
    return guarded(cli, arguments, "datagen")
