"""Carry out the steps of docker/Dockerfile, and the commands of docker/compose.yaml, where no container engine is.

    python tests/docker_image.py ROOT [image|compose]          (as root; both parts, or one of them)

ROOT: a clean root filesystem that stands for the base image: Debian bookworm with a Python 3.11 found as `python`. It
is changed. COPY obeys Dockerfile.dockerignore; RUN is executed in a chroot with ENV and WORKDIR as they then are.
Scheduler, workers and builder are then plain processes in that chroot, as the user and with the environment that
compose.yaml gives them, and the dataset is verified. /proc and /dev, with a /dev/shm that all may write, are mounted
there. Any step that fails ends it with that step's status.
"""

from __future__ import annotations

import fnmatch
import os
import shlex
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

HERE = Path(__file__).resolve().parents[1]
DOCKER = HERE / "docker"


def instructions(text: str) -> Iterator[tuple[str, str]]:
    """Name and arguments of each instruction of a Dockerfile."""
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    for line in "\n".join(lines).replace("\\\n", " ").splitlines():
        name, _, arguments = line.partition(" ")
        yield name, arguments.strip()


class Image:
    """A root filesystem, and what the instructions so far have set."""

    def __init__(self, root: Path) -> None:
        self.root, self.work = root, "/"
        # What the base image's own environment is.
        self.env = {"PATH": "/usr/local/bin:/usr/local/sbin:/usr/sbin:/usr/bin:/sbin:/bin", "HOME": "/root"}
        self.entrypoint: list[str] = []
        ignored = (DOCKER / "Dockerfile.dockerignore").read_text().split()
        self.ignored = [pattern.removeprefix("**/") for pattern in ignored]

    def carry_out(self, name: str, arguments: str) -> None:
        """One instruction."""
        print(f"{name} {arguments}", flush=True)
        if name == "WORKDIR":
            self.work = arguments
            self.inside(arguments).mkdir(parents=True, exist_ok=True)
        elif name == "ENV":
            self.env |= dict(pair.split("=", 1) for pair in shlex.split(arguments))
        elif name == "COPY":
            *sources, target = arguments.split()
            for source in sources:
                self._copy(HERE / source, self.inside(target), into=target.endswith("/"))
        elif name == "RUN":
            subprocess.run(self.command(["sh", "-c", arguments]), env=self.env, check=True)
        elif name == "ENTRYPOINT":
            self.entrypoint = yaml.safe_load(arguments)
        elif name not in ("FROM", "CMD"):
            raise SystemExit(f"{name}: an instruction that is not known here")

    def inside(self, path: str) -> Path:
        """A path of the image, seen from outside."""
        return self.root / os.path.normpath(os.path.join(self.work, path)).lstrip("/")

    def command(self, words: list[str], user: str = "0:0") -> list[str]:
        """What runs words in the image."""
        return [
            "chroot",
            f"--userspec={user}",
            str(self.root),
            "sh",
            "-c",
            f"cd {self.work} && exec {shlex.join(words)}",
        ]

    def _copy(self, source: Path, target: Path, into: bool) -> None:
        def left_out(_: str, names: list[str]) -> set[str]:
            return {name for name in names if any(fnmatch.fnmatch(name, pattern) for pattern in self.ignored)}

        if source.is_dir():
            # Of a folder COPY takes what is in it.
            shutil.copytree(source, target, ignore=left_out, dirs_exist_ok=True)
            return
        target = target / source.name if into else target
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(source, target)


def filled_in(value: Any) -> Any:
    """A value of the compose file, with the default of each ${NAME:-default}."""
    if isinstance(value, list):
        return [filled_in(one) for one in value]
    text = str(value)
    while "${" in text:
        before, _, rest = text.partition("${")
        inner, _, after = rest.partition("}")
        text = before + inner.partition(":-")[2] + after
    return text


def main(root: Path, parts: tuple[str, ...]) -> None:
    image = Image(root)
    for name, arguments in instructions((DOCKER / "Dockerfile").read_text()):
        if "image" in parts or name in ("WORKDIR", "ENV", "ENTRYPOINT"):
            image.carry_out(name, arguments)
    if "compose" in parts:
        carry_out_compose(root, image)


def carry_out_compose(root: Path, image: Image) -> None:
    """Scheduler and two workers, four scenes of the builder's configuration, and their verification."""
    compose = yaml.safe_load((DOCKER / "compose.yaml").read_text())
    services = compose["services"]
    user = filled_in(services["worker"]["user"])
    datasets = root / "datasets"
    datasets.mkdir(exist_ok=True)
    os.chown(datasets, *map(int, user.split(":")))
    with (root / "etc/hosts").open("a") as hosts:
        hosts.write("127.0.0.1 localhost scheduler\n")
    environment = image.env | {name: str(value) for name, value in services["worker"]["environment"].items()}

    def words(service: str) -> list[str]:
        of = services[service]
        return filled_in([*of.get("entrypoint", image.entrypoint), *of.get("command", [])])

    def run(command: list[str]) -> subprocess.Popen[bytes]:
        print(shlex.join(command), flush=True)
        return subprocess.Popen(image.command(command, user), env=environment)

    running = [run(words("scheduler"))]
    try:
        last = time.monotonic() + 60
        while True:
            try:
                socket.create_connection(("127.0.0.1", 8786), 2).close()
                break
            except OSError:
                if time.monotonic() > last:
                    raise
                time.sleep(0.5)
        running += [run(words("worker")) for _ in range(2)]
        for command in (
            [*words("builder"), "--scenes", "4"],
            ["datagen", "verify", "/datasets/quickstart.zarr", "--deep"],
        ):
            status = run(command).wait()
            if status:
                raise SystemExit(status)
    finally:
        for process in running:
            process.terminate()
        for process in running:
            process.wait()
    owner = (datasets / "quickstart.zarr" / "dataset.json").stat()
    assert f"{owner.st_uid}:{owner.st_gid}" == user, owner
    print("the image's steps and the compose file's commands: done")


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve(), tuple(sys.argv[2:]) or ("image", "compose"))
