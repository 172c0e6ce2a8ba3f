"""Builds on the command line that a signal ends at a random moment: what they say, and what they leave."""

from __future__ import annotations

import os
import random
import re
import signal
import subprocess
import sys
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path

from datagen.store import committed_records, read_manifest, verify
from datagen.store.verify import dataset_digest

CONFIG = """
schema_version: 1
name: interrupted
seed: 1
scenes: 64
scene: {layout: {kind: l_corridor}, contents: [{kind: box}]}
capture: {scan: {rows: 2, columns: 2}, time: {bins: 64, bin_width_ps: 800}}
transport: {target: 0.1}
store: {fields: [histogram, depth], scenes_per_shard: 4}
"""
STATUS = {signal.SIGINT: 130, signal.SIGTERM: 143}
LATEST_S = 10.0
"""Signals come up to so many seconds after the start: half go to imports and to workers that are starting."""
PATIENCE_S = 60.0
ONE_LINE = re.compile(
    r"datagen: (interrupted|terminated); (what is committed stays|not finished), run the same command again.*"
)
"""A signal may come before the command is known."""
PROGRESS = re.compile(r"starting|checking the configuration|.*, once after an installation.*|\d+ of \d+ s.*|")


def processes_of(session: int) -> list[str]:
    """The processes of a session that are alive."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            name, _, rest = (folder / "stat").read_text().rpartition(")")
            state, _, _, of_session = rest.split()[:4]
            if int(of_session) == session and state != "Z":
                found.append(f"{folder.name} {name}")
    return found


def half_written(root: Path) -> set[str]:
    """Files below a dataset that belong to no committed shard."""
    if not (root / "dataset.json").is_file():
        return {path.name for path in root.rglob("*") if path.is_file()}
    whole = committed_records(root, read_manifest(root), hashes=True)
    due = {root / name for record in whole for name in record.files}
    due |= {root / f"build/shard-{record.shard:06d}.json" for record in whole}
    values = [path for path in root.glob("data.zarr/*/c/*/**/*") if path.is_file()]
    fields = {path.relative_to(root).parts[1] for path in due if "data.zarr" in path.parts}
    of_shards = {path for path in values if path.relative_to(root).parts[1] in fields or not whole}
    of_shards |= set(root.glob("build/*")) | set(root.rglob("*.partial"))
    return {str(path.relative_to(root)) for path in of_shards - due}


def is_ready(child: subprocess.Popen[str]) -> bool:
    """Whether the command handles SIGTERM; Python itself answers signals that come before its first line of ours."""
    with suppress(OSError):
        caught = re.search(r"SigCgt:\s*(\w+)", Path(f"/proc/{child.pid}/status").read_text())
        return caught is not None and bool(int(caught[1], 16) >> (signal.SIGTERM - 1) & 1)
    return False


def interrupted(kind: signal.Signals, root: Path, group: bool, delay: float) -> list[str] | None:
    """A line for each error of a build that got the signal; None if the build ended before the signal."""
    config, temporary = root.with_suffix(".yaml"), root.with_suffix(".tmp")
    config.write_text(CONFIG)
    temporary.mkdir(exist_ok=True)
    child = subprocess.Popen(
        [sys.executable, "-m", "datagen", "build", str(config), str(root), "--workers", "2"],
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True, text=True,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "TMPDIR": str(temporary)},
        # Where the tests run in the background of a shell, Ctrl-C is ignored, and children would inherit that.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip
    while not is_ready(child):
        assert child.poll() is None, child.communicate()
        time.sleep(0.001)
    with suppress(subprocess.TimeoutExpired):
        child.wait(delay)
        assert child.returncode == 0, child.communicate()
        return None
    (os.killpg if group else os.kill)(child.pid, kind)
    began = time.monotonic()
    _, said = child.communicate(timeout=PATIENCE_S)
    took = time.monotonic() - began
    due = (ONE_LINE, PROGRESS)
    wrong = [f"said: {line}" for line in said.splitlines() if not any(of.fullmatch(line) for of in due)]
    if len(ONE_LINE.findall(said)) != 1:
        wrong.append(f"said the line {len(ONE_LINE.findall(said))} times")
    if child.returncode != STATUS[kind]:
        wrong.append(f"status {child.returncode}")
    while (left := processes_of(child.pid)) and time.monotonic() < began + PATIENCE_S:
        time.sleep(0.02)
    wrong += [f"left process {process}" for process in left]
    wrong += [f"left a temporary file: {path}" for path in temporary.iterdir()]
    wrong += [f"left half written: {name}" for name in half_written(root)]
    return [f"{kind.name} after {delay:.2f} s ({took:.1f} s to end): {line}" for line in wrong]


def interruptions(
    kind: signal.Signals, tries: int, folder: Path, seed: int, latest_s: float, resume: bool
) -> Counter[str]:
    """How many builds were ended, what was wrong with how many, and how many went on until they were whole; what is
    wrong is printed.

    resume : let the last one end, and hold it against a dataset that was built without interruptions.
    """
    rng, counted = random.Random(seed), Counter[str]()
    while counted["ended"] < tries:
        root = folder / str(counted["whole"])
        # A terminal sends Ctrl-C to all processes, `kill` SIGTERM to one, `timeout` to all.
        group = kind == signal.SIGINT or counted["ended"] % 2 == 0
        wrong = interrupted(kind, root, group, rng.uniform(0.0, latest_s))
        counted["whole" if wrong is None else "ended"] += 1
        counted.update(wrong=bool(wrong), tracebacks="Traceback" in str(wrong))
        print(*(wrong or ()), sep="\n", end="\n" if wrong else "", flush=True)
    if resume:
        for name in (root.name, "anew"):
            assert interrupted(kind, folder / name, False, 10 * PATIENCE_S) is None
        found = [path for path in folder.iterdir() if (path / "samples.parquet").is_file()]
        counted["wrong"] += len({dataset_digest(path) for path in found}) != 1
        counted["wrong"] += any(verify(path, deep=True).problems for path in found)
        counted["whole"] = len(found) - 1
    return counted
