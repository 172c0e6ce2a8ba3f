"""Whether the tests notice faults: `python tests/tools/mutations.py [NAME …] [--limit 300]`.

Most mutations are small faults of physics in one kernel: a cosine or an attenuation that is missing, a density that
is not the one of the draws, an edge of a bin, a shadow ray that is not traced. Others are faults of what is made of
the light: evidence, labels, objects, files. The script applies one after the other to a copy of the sources and runs
tests there: first the one that is about this fault, then, of a fault of the light, all of `TESTS` in their order, up
to the first that fails. It prints a row for each mutation. The first row, "none", is that of the sources as they are,
which have to pass.

Exit status 1 where no test fails within the limit, or where one fails by anything but its own assertion: a mutation
that does not run says nothing about the tests.

`tests/equivalence/test_mutations.py` holds that each mutation still finds the text that it changes.
"""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
COPIED = ("datagen", "scene_library", "tests", "configs", "examples", "pyproject.toml")
"""What the tests below read."""
PHYSICS, EQUIVALENCE = "tests/physics/", "tests/equivalence/"
TESTS = (
    EQUIVALENCE + "test_materials.py",
    PHYSICS + "test_sampling.py",
    PHYSICS + "test_brdf.py",
    PHYSICS + "test_arrival_times.py",
    PHYSICS + "test_all_bounces.py",
    PHYSICS + "test_blocks.py",
    PHYSICS + "test_paths_laws.py",
    PHYSICS + "test_primary_truths.py",
    PHYSICS + "test_convex_bodies.py",
    EQUIVALENCE + "test_paths.py",
    EQUIVALENCE + "test_cuts_and_paths.py",
    EQUIVALENCE + "test_lines_of_sight.py",
    EQUIVALENCE + "test_bins_add_up.py",
    PHYSICS + "test_curved_pixels.py",
    PHYSICS + "test_cuts.py",
    PHYSICS + "test_accuracy_target.py",
    PHYSICS + "test_primary_laws.py",
    PHYSICS + "test_dark_windows.py",
    EQUIVALENCE + "test_all_ways.py",
)
"""Files with laws of the light, those that tell most in a second first."""
BESIDE = (
    "tests/capture/test_beam.py",
    "tests/capture/test_flood.py",
    "tests/evidence/test_evidence_image.py",
    "tests/evidence/test_presence.py",
    "tests/formats/test_exports.py",
    "tests/labels/test_label_images.py",
    "tests/labels/test_label_volumes.py",
    "tests/scene/test_contents.py",
    "tests/scene/test_meshes.py",
    "tests/stability/test_doubts.py",
    "tests/store/test_build.py",
    "tests/store/test_partial_reads.py",
)
"""Files with laws of what is made of the light, and of what goes into it."""
LIMIT_S = 300.0
HEAD = "| mutation | kernel | first test that failed | seconds |\n|---|---|---|---|"


@dataclass(frozen=True)
class Mutation:
    """A fault.

    name : of the fault, its way to light first. module : file in `datagen/transport/`, or from the root, if it begins
    with a folder there. before, after : the text that is found there once, and what takes its place. law : the test
    that is about what is wrong now: a file of `TESTS` or `BESIDE`, a function there and perhaps one of its cases.
    """

    name: str
    module: str
    before: str
    after: str
    law: str

    @property
    def path(self) -> Path:
        """The module's file, relative to the root."""
        from_root = self.module.startswith(("datagen/", "scene_library/"))
        return Path(self.module) if from_root else Path("datagen", "transport", self.module)

    def mutated(self, source: str) -> str:
        """The module's source with the fault in it; `ValueError` if the text is not there exactly once."""
        if (times := source.count(self.before)) != 1:
            raise ValueError(f"{self.name}: the text to change is found {times} times in {self.module}, not once")
        return source.replace(self.before, self.after)


PATCH = PHYSICS + "test_primary_truths.py::test_small_patch_amplitude_and_arrival_time"
RECTANGLE = PHYSICS + "test_primary_truths.py::test_rectangle_against_quadrature_per_3_mm_bin"
OCCLUDER = PHYSICS + "test_primary_truths.py::test_an_occluder_casts_an_exact_shadow"
SPHERE = PHYSICS + "test_all_bounces.py::test_sphere_energy_for_three_to_six_bounces"
BLOCKS_IN_SPHERE = PHYSICS + "test_blocks.py::test_energy_inside_of_a_sphere"
SHADOWS_AND_AIR = PHYSICS + "test_blocks.py::test_shadows_and_air_are_those_of_plain_paths"
SPREAD = PHYSICS + "test_arrival_times.py::test_light_of_an_element_and_a_cluster"
IN_FOG = EQUIVALENCE + "test_paths.py::test_in_fog_with_the_direct_return_and_five_bounces"
DARK = PHYSICS + "test_dark_windows.py::"
FLOODS, BUILDS = "tests/capture/test_flood.py::", "tests/store/test_build.py::"
VOLUMES, MESHES = "tests/labels/test_label_volumes.py::", "tests/scene/test_meshes.py::"
IMAGE = "tests/evidence/test_evidence_image.py::test_pixels_of_an_object_in_view_add_up_to_its_own_detections"
BLOCKS_ELSEWHERE = (
    "tests/store/test_partial_reads.py::"
    "test_a_table_of_blocks_that_points_elsewhere_is_refused_though_its_checksum_is_right"
)
DRAWS = PHYSICS + "test_brdf.py::test_sampler_has_the_density_it_states"

MUTATIONS = (
    # Cuts.
    Mutation(
        "cuts: weight without the cosine at the FoV point", "weights.py",
        "w = f1 * f2 * f3 * (up1 * up3) * (in2 * out2)", "w = f1 * f2 * f3 * (up1 * r3) * (in2 * out2)",
        PATCH + "[wall-cuts]",
    ),
    Mutation(
        "cuts: weight with air on the first leg alone", "weights.py",
        "transmittance(attenuation, r1 + r3), r1, r3", "transmittance(attenuation, r1), r1, r3",
        PATCH + "[wall-cuts]",
    ),
    Mutation(
        "cuts: hidden point drawn by guesses, density of even draws", "cut_steps.py",
        "density = (t0 * at[a] + t1 * at[b] + t2 * at[c]) / light", "density = 1.0 / area",
        RECTANGLE + "[5-cuts]",
    ),
    Mutation(
        "cuts: a FoV point drawn from several stands for one", "cut_steps.py",
        "light = pair.power * each * w * pool.weight[j]", "light = pair.power * w * pool.weight[j]",
        PATCH + "[wall-cuts]",
    ),
    Mutation(
        "cuts: a cluster opened without its last quarter", "cut_elements.py",
        "for j in range(4):\n        inner = 4 * c", "for j in range(3):\n        inner = 4 * c",
        PHYSICS + "test_primary_laws.py::test_arrival_times_of_a_large_pixel_are_spread",
    ),
    Mutation(
        "cuts: a box divided into its first half twice", "cut_elements.py",
        "push(tag, top + 1, Waiting.BOX, tree.children[at, 1], c, q, many)",
        "push(tag, top + 1, Waiting.BOX, tree.children[at, 0], c, q, many)",
        PHYSICS + "test_primary_laws.py::test_finer_triangles_and_another_order_are_the_same_surface",
    ),
    Mutation(
        "cuts: no shadow ray to the FoV point", "cuts.py", "for leg in range(2):", "for leg in range(1):",
        OCCLUDER + "[0.1-cuts]",
    ),
    Mutation(
        "cuts: FoV points without the air to the sensor", "fov_clusters.py",
        "last_leg), out=found.weight)", "last_leg))",
        PATCH + "[wall-cuts]",
    ),
    Mutation(
        "cuts: a flat cluster with a side of twice the length", "fov_clusters.py",
        "sensor[k] + w * far, one, two", "sensor[k] + w * far, 2.0 * one, two",
        PHYSICS + "test_primary_laws.py::test_arrival_times_of_a_large_pixel_are_spread",
    ),
    # Time bins.
    Mutation(
        "times: edges of bins half a bin early", "arrival_times.py",
        "f = np.float64(i) + 1.0 - t", "f = np.float64(i) + 1.5 - t", SPREAD + "[no cluster-0]",
    ),
    Mutation(
        "times: light before the window counts from its third bin alone", "arrival_times.py",
        "steps[0] += one\n", "steps[0] += 0.0 * one\n", PHYSICS + "test_arrival_times.py::test_windows_of_windows[0]",
    ),
    Mutation(
        "times: a box of bins without its ends", "arrival_times.py",
        "most = 1.0 / (m + 1.0)\n", "most, end = 1.0 / (m + 1.0), 0.0\n", SPREAD + "[as large-0]",
    ),
    Mutation(
        "times: a narrow cluster without its last bin", "arrival_times.py",
        "scale * one.oldest * two.oldest", "0.0", SPREAD + "[a narrow cluster-0]",
    ),
    Mutation(
        "times: light that changes over a cluster the wrong way round", "arrival_times.py",
        "s1 + one.tilt * t1", "s1 - one.tilt * t1", SPREAD + "[a point, weights that change-0]",
    ),
    Mutation(
        "times: corners at one time are not told apart", "arrival_times.py",
        "tie = max(TIE * span, TIED)", "tie = 0.0", SPREAD + "[two corners at once-0]",
    ),
    Mutation(
        "times: without the leg from the laser", "cut_steps.py",
        "lasers.leg[i] if setup.scene.from_source else 0.0", "0.0 * lasers.leg[i]",
        EQUIVALENCE + "test_cuts_and_paths.py::test_scans",
    ),
    Mutation(
        "times: all of a pixel at those of its middle", "cut_steps.py",
        "(0.0, 0.0) if is_narrow else (one * per, two * per)", "(0.0, 0.0)",
        PHYSICS + "test_primary_laws.py::test_arrival_times_of_a_large_pixel_are_spread",
    ),
    # Blocks.
    Mutation(
        "blocks: light of an end without its cosine", "block_steps.py",
        "evaluate(k, row, m, back, v) * up * down / r**2 * ends.gain[e]",
        "evaluate(k, row, m, back, v) * down / r**2 * ends.gain[e]",
        BLOCKS_IN_SPHERE + "[4]",
    ),
    Mutation(
        "blocks: legs to the ends without air", "block_steps.py",
        "* ends.gain[e] * math.exp(-scene.air * r)", "* ends.gain[e]",
        SHADOWS_AND_AIR + "[4]",
    ),
    Mutation(
        "blocks: density of vertices without the cosine there", "block_steps.py",
        "x.density[i, h] = pdf(k, row, m, back, v) * down / r**2",
        "x.density[i, h] = pdf(k, row, m, back, v) * math.copysign(1.0, down) / r**2",
        BLOCKS_IN_SPHERE + "[4]",
    ),
    Mutation(
        "blocks: hidden legs keep their light", "block_steps.py",
        "x.light[i, h] = x.density[i, h] = 0.0", "x.density[i, h] = 0.0",
        SHADOWS_AND_AIR + "[4]",
    ),
    Mutation(
        "blocks: no shadow rays between the vertices of pairs", "blocks.py",
        "[self.is_hidden(origin[:k], span[:k]),", "[np.zeros(k, np.bool_),",
        SHADOWS_AND_AIR + "[4]",
    ),
    Mutation(
        "blocks: heuristic without the way back", "block_steps.py",
        "expected += rays * (onto_y * abs(down) + back_way)", "expected += rays * (onto_y * abs(down))",
        BLOCKS_IN_SPHERE + "[4]",
    ),
    Mutation(
        "blocks: roulette without compensation", "blocks.py",
        "light /= chance[:, None].astype(np.float32)", "pass",
        BLOCKS_IN_SPHERE + "[all from 5]",
    ),
    Mutation(
        "blocks: light half a bin early", "block_steps.py",
        "r * bins.per_metre - bins.start + 1.0", "r * bins.per_metre - bins.start + 0.5",
        PHYSICS + "test_blocks.py::test_arrival_times_inside_of_a_sphere[4]",
    ),
    # Plain paths.
    Mutation(
        "paths: weight without the cosine at the FoV point", "path_steps.py",
        "f_x * f_v * cos_x * cos_v / (square * ways)", "f_x * f_v * cos_x / (square * ways)",
        PATCH + "[wall-paths]",
    ),
    Mutation(
        "paths: heuristic without the way back", "path_steps.py",
        "ways += onto_x * cos_x / (square * x.density)", "ways += 0.0", SPHERE,
    ),
    Mutation(
        "paths: points drawn evenly, density by guesses", "path_aim.py",
        "running += density[start + j] * area[aim.triangles[first + j]]",
        "running += area[aim.triangles[first + j]]",
        IN_FOG,
    ),
    Mutation(
        "paths: no shadow ray to the FoV point", "paths.py",
        "yield order, self.unhidden_paths(self.join(x, v, order))",
        "yield order, first_rows(self.buffers.found, self.join(x, v, order))",
        OCCLUDER + "[0.1-paths]",
    ),
    Mutation(
        "paths: numbers of the second vertex again for the third", "path_steps.py",
        "u, v = samples.numbers[s, 7], samples.numbers[s, 8]", "u, v = samples.numbers[s, 3], samples.numbers[s, 4]",
        IN_FOG,
    ),
    Mutation(
        "paths: roulette without compensation", "paths.py",
        "rows_of(y._replace(power=y.power / stays), drawn < stays)", "rows_of(y, drawn < stays)",
        PHYSICS + "test_all_bounces.py::test_russian_roulette_follows_all_orders_without_bias",
    ),
    Mutation(
        "paths: time rounded up to the next bin", "path_steps.py",
        "place = math.floor((found.path[k]", "place = math.ceil((found.path[k]",
        EQUIVALENCE + "test_paths.py::test_light_is_that_of_the_paths",
    ),
    # What all ways share.
    Mutation(
        "rays: shadow rays end a tenth short", "rays.py",
        "reach = np.ones(len(origins), np.float32)", "reach = np.full(len(origins), 0.9, np.float32)",
        OCCLUDER + "[0.1-cuts]",
    ),
    Mutation(
        "rays: surfaces met from behind keep their normal", "rays.py",
        "sign = -1.0 if approach > 0.0 else 1.0", "sign = 1.0", SPHERE,
    ),
    Mutation(
        "BRDF: GGX without the 2 of its Smith terms", "brdf/ggx.py",
        "masking = 0.5 / (cos_out", "masking = 0.25 / (cos_out",
        EQUIVALENCE + "test_materials.py::test_a_brdf_is_what_its_source_prints",
    ),
    Mutation(
        "BRDF: Phong's lobe drawn by another exponent", "brdf/phong.py",
        "/ (exponent + 1.0)), v)", "/ (exponent + 2.0)), v)",
        DRAWS,
    ),
    Mutation(
        "BRDF: Oren–Nayar's even share over the whole sphere", "brdf/oren_nayar.py",
        "return share / (2.0 * math.pi) +", "return share / (4.0 * math.pi) +",
        DRAWS,
    ),
    # Floods, and scenes too large for their light.
    Mutation(
        "floods: shares of a delay between two bins exchanged", "flood.py",
        "((whole, 1 - (bins - whole)), (whole + 1, bins - whole))",
        "((whole, bins - whole), (whole + 1, 1 - (bins - whole)))",
        FLOODS + "test_a_delay_moves_the_mean_time_of_light_and_loses_none_but_at_the_ends",
    ),
    Mutation(
        "floods: the second vertex of a beam in a direction of uniform density", "flood.py",
        "first.power * np.pi * brdf(", "first.power * 2 * np.pi * dots(first.normal, out) * brdf(",
        "tests/capture/test_beam.py::test_two_bounces_inside_of_a_sphere_have_their_closed_form",
    ),
    Mutation(
        "floods: the leg between two vertices of a beam takes no time", "flood.py",
        "first.legs_m[met] + between,", "first.legs_m[met],",
        "tests/capture/test_beam.py::test_two_bounces_inside_of_a_sphere_have_their_closed_form",
    ),
    Mutation(
        "floods: light by angle all at the lower node", "flood.py",
        "(np.minimum(low + 1, count - 1), node - low)", "(low, node - low)",
        "tests/capture/test_beam.py::test_light_by_angle_adds_up_and_follows_the_cosine",
    ),
    Mutation(
        "floods: laser points count alike whatever their share", "problem.py",
        "share = capture.laser.shares if", "share = 0.0 * capture.laser.shares + 1 / len(capture.laser.targets) if",
        FLOODS + "test_a_flood_whose_first_point_has_all_light_is_that_point_alone",
    ),
    Mutation(
        "floods: an element that is drawn by chance stands for itself alone", "cut_steps.py",
        "batch.level[used] = light / chance, ", "batch.level[used] = light, ",
        DARK + "test_a_flood_has_the_light_of_its_paths",
    ),
    Mutation(
        "floods: each laser point of a block has all light", "blocks.py",
        "problem.pairs.share * np.exp(", "np.exp(", DARK + "test_more_bounces_of_a_flood_are_those_of_its_points",
    ),
    Mutation(
        "floods: direct light does not count in what is asked of the primary", "simulate.py",
        "beside = beside._replace(whole=", "beside._replace(whole=",
        DARK + "test_direct_light_counts_in_what_is_asked",
    ),
    Mutation(
        "claims: no light met is none there", "simulate.py",
        "0.0 if is_proven or _is_dark(problem) else math.nan", "0.0",
        DARK + "test_light_that_something_hides_is_not_claimed_to_be_none",
    ),
    Mutation(
        "cuts: what cannot arrive within the window is cut as what can", "cut_elements.py",
        "return late * setup.per_metre > setup.start and", "return True or",
        DARK + "test_little_light_is_found_where_it_is",
    ),
    Mutation(
        "doubts: a ray offset is never large", "doubts.py", "if caster.offset_m > COARSE * leg > 0:", "if False:",
        "tests/stability/test_doubts.py::test_whatever_stretches_a_scene_is_named_at_every_scale_and_place",
    ),
    # Evidence.
    Mutation(
        "evidence: the image of a flood without its beam's weights", "datagen/evidence/image.py",
        "light = capture.laser.weights * len(light)", "pass", IMAGE + "[fading-gated-0.03]",
    ),
    Mutation(
        "evidence: a flood's pairs counted as those of a scan", "datagen/evidence/image.py",
        "times, histogram[:, 0] = times / len(light), 0", "histogram[:, 0] = 0", IMAGE + "[an even flood-gated-0.03]",
    ),
    Mutation(
        "evidence: the image without the pixels' sensitivity", "datagen/evidence/image.py",
        "return middle / total[:, None], footprints.mean(axis=(1, 2))",
        "return middle / total[:, None], np.ones(pixels)", IMAGE + "[sensitive in places-gated-0.03]",
    ),
    Mutation(
        "evidence: presence's floor from one simulation", "datagen/evidence/presence.py",
        "error = np.hypot(whole.stderr, without.stderr)", "error = whole.stderr",
        "tests/evidence/test_presence.py::test_the_floor_is_made_of_the_errors_of_both_simulations",
    ),
    # Labels.
    Mutation(
        "labels: images leave structure out by its nearest corner", "datagen/labels/images.py",
        "in_view[:, :, 2].max(axis=1) > tolerance", "in_view[:, :, 2].min(axis=1) > tolerance",
        "tests/labels/test_label_images.py::"
        "test_structure_that_begins_in_the_plane_of_the_wall_is_seen_as_an_object_there_is",
    ),
    Mutation(
        "labels: a voxel's longest side for its thinnest", "datagen/labels/volumes.py",
        "thinnest = float(grid.voxel_m.min())", "thinnest = float(grid.voxel_m.max())",
        VOLUMES + "test_a_plate_thicker_than_the_thinnest_side_of_a_voxel_is_exact",
    ),
    Mutation(
        "labels: solids with holes of up to 15 %", "datagen/labels/solids.py",
        "LARGEST_HOLE_SHARE = 0.05", "LARGEST_HOLE_SHARE = 0.15",
        VOLUMES + "test_a_ball_whose_hole_is_more_than_a_twentieth_is_open",
    ),
    # Objects.
    Mutation(
        "objects: the front of a mesh whose −z is up", "scene_library/meshes.py", '"-z": "y"', '"-z": "-y"',
        MESHES + "test_a_file_upside_down_whose_front_is_not_stated_is_the_same_object",
    ),
    Mutation(
        "objects: a front of −z as one of z", "scene_library/meshes.py",
        '-1.0 if name.startswith("-") else 1.0', '-1.0 if name in ("-x", "-y") else 1.0',
        MESHES + "test_every_front_is_turned_to_where_fronts_are",
    ),
    Mutation(
        "objects: nothing may stand under what hangs", "scene_library/placement.py",
        "max(other.bottom_m - candidate.top_m, candidate.bottom_m - other.top_m)", "candidate.bottom_m - other.top_m",
        "tests/scene/test_contents.py::test_an_object_may_stand_under_a_hanging_one_that_is_clear_of_it",
    ),
    # Files.
    Mutation(
        "files: recordings of a power of two of bins doubled", "datagen/formats/recording.py",
        "(lead + self.time.bins - 1).bit_length()", "(lead + self.time.bins).bit_length()",
        "tests/formats/test_exports.py::test_time_is_padded_to_the_next_power_of_two_and_no_further",
    ),
    Mutation(
        "files: half-written files of a build at work removed", "datagen/store/files.py",
        "if try_lock(handle, otherwise=False):", "if try_lock(handle, otherwise=False) or True:",
        BUILDS + "test_half_written_files_go_unless_their_writer_is_at_work",
    ),
    Mutation(
        "files: half-written files removed where there are no locks", "datagen/store/files.py",
        "if try_lock(handle, otherwise=False):", "if try_lock(handle, otherwise=True):",
        BUILDS + "test_half_written_files_go_unless_their_writer_is_at_work",
    ),
    Mutation(
        "files: a failed scene made again if its result was lost", "datagen/building/shard_job.py",
        "(record.failures and record.finished <= submitted)", "record.failures",
        BUILDS + "test_a_failed_scene_whose_result_was_lost_is_not_made_again",
    ),
    Mutation(
        "files: blocks before those of a blosc frame", "datagen/store/reader.py",
        "begins.min() < _HEADER_BYTES + 4 * count or begins.max() >= stored", "begins.max() >= stored",
        BLOCKS_ELSEWHERE,
    ),
    Mutation(
        "files: blocks past the end of a blosc frame", "datagen/store/reader.py",
        "begins.min() < _HEADER_BYTES + 4 * count or begins.max() >= stored",
        "begins.min() < _HEADER_BYTES + 4 * count", BLOCKS_ELSEWHERE,
    ),
)  # fmt: skip


def copied(folder: Path) -> None:
    """Copy what the tests need, without what was compiled from it."""
    for name in COPIED:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(ROOT / name, folder / name)


def failed(folder: Path, tests: Sequence[str], limit_s: float) -> str | None:
    """The line by which pytest names the first test that fails in a folder; empty if all pass, None at the limit."""
    # Not the suite's own order, which conftest.py makes for several processes: the quickest first.
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-rfE", "--noconftest", "--tb=no"]
    environment = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    environment |= {"PYTHONPATH": str(folder), "COLUMNS": "500"}
    environment |= {f"{library}_NUM_THREADS": "1" for library in ("OMP", "OPENBLAS", "MKL")}
    running = subprocess.Popen(
        [*command, "-p", "no:cacheprovider", *tests], cwd=folder, env=environment, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True,
    )  # fmt: skip
    try:
        said, _ = running.communicate(timeout=max(limit_s, 0.0))
    except subprocess.TimeoutExpired:
        # Tests may have started processes of their own.
        os.killpg(running.pid, signal.SIGKILL)
        running.communicate()
        return None
    named = [line for line in said.splitlines() if line.startswith(("FAILED ", "ERROR "))]
    return "" if running.returncode == 0 else named[0] if named else said.strip().splitlines()[-1]


def noticed(line: str | None) -> bool:
    """Whether a test failed by its own assertion."""
    return line is not None and line.startswith("FAILED ") and " - assert" in line.lower()


def row(name: str, kernel: str, line: str | None, seconds: float) -> str:
    """A row of the table."""
    if noticed(line):
        said = "`" + str(line).removeprefix("FAILED ").partition(" - ")[0].removeprefix("tests/") + "`"
    else:
        said = "NOT NOTICED" if not line else f"DOES NOT RUN: {line}"
    return f"| {name} | {kernel} | {said} | {seconds:.0f} |"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", help="only the mutations whose name contains one of these")
    parser.add_argument("--limit", type=float, default=LIMIT_S, help="seconds for each mutation")
    given = parser.parse_args()
    chosen = [one for one in MUTATIONS if not given.names or any(name in one.name for name in given.names)]
    if not chosen:
        parser.error("no mutation has such a name")
    print(HEAD, flush=True)
    everywhere = True
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        copied(folder)
        begun = time.perf_counter()
        # Of a few mutations only the tests that are about them need pass before; there is no limit for that.
        laws = list(dict.fromkeys(one.law for one in chosen))
        beside = [law for law in laws if law.partition("::")[0] in BESIDE]
        line = failed(folder, laws if given.names else [*TESTS, *beside], 1e6)
        seconds = time.perf_counter() - begun
        if line != "":
            print(f"| none | | FAILS: {line} | {seconds:.0f} |\n\nThe tests fail without any mutation.")
            return 1
        print(f"| none | | | {seconds:.0f} |", flush=True)
        for one in chosen:
            source = (ROOT / one.path).read_text()
            (folder / one.path).write_text(one.mutated(source))
            begun = time.perf_counter()
            line = failed(folder, [one.law], given.limit)
            if line == "" and one.law.partition("::")[0] in TESTS:
                line = failed(folder, TESTS, given.limit - (time.perf_counter() - begun))
            (folder / one.path).write_text(source)
            print(row(one.name, one.module, line, time.perf_counter() - begun), flush=True)
            everywhere &= noticed(line)
    return int(not everywhere)


if __name__ == "__main__":
    sys.exit(main())
