"""A run as docs/resuming.md writes it, whole, and stopped and taken up by new objects.

`python FILE WAY DATASET OUT WORKERS` prints the steps of the whole run and whether both are the same. RANK and
WORLD_SIZE say which process it is, of how many.
"""

from __future__ import annotations

import hashlib
import os
import re
import sys
import warnings
from pathlib import Path
from typing import Any

import torch
from torch import distributed

import datagen as dg

PAGE = Path(__file__).resolve().parents[2] / "docs/resuming.md"
RANK, RANKS = (int(os.environ.get(name, default)) for name, default in (("RANK", "0"), ("WORLD_SIZE", "1")))
EPOCHS = 3


class StoppedHere(Exception):
    """As by whoever stops a run."""


class Steps:
    """Steps of training: the scenes of each batch and a digest of their counts. It stops after `most` of them."""

    def __init__(self, most: int) -> None:
        self.found: list[list[tuple[int, str]]] = []
        self.most = most

    def __call__(self, batch: dict[str, torch.Tensor]) -> None:
        if len(self.found) == self.most:
            raise StoppedHere
        if distributed.is_initialized():
            distributed.barrier()  # as where gradients are added up
        rows = zip(batch["scene"].tolist(), batch["histogram"], strict=True)
        self.found.append([(scene, hashlib.sha256(counts.numpy().tobytes()).hexdigest()) for scene, counts in rows])


def lightning(names: dict[str, Any], data: dg.TransientDataset, step: Steps, folder: Path, workers: int) -> None:
    from pytorch_lightning import LightningModule

    class Model(LightningModule):
        def __init__(self) -> None:
            super().__init__()
            self.weight = torch.nn.Parameter(torch.zeros(1))

        def training_step(self, batch: dict[str, torch.Tensor], number: int) -> torch.Tensor:
            step(batch)
            return (self.weight * batch["histogram"].mean()).sum()

        def configure_optimizers(self) -> torch.optim.Optimizer:
            return torch.optim.SGD(self.parameters(), 0.1)

    quiet = {"logger": False, "enable_progress_bar": False, "enable_model_summary": False, "accelerator": "cpu"}
    names["train_lightning"](
        data, Model(), folder, workers, RANK, RANKS, max_epochs=EPOCHS, max_steps=step.most, devices=RANKS,
        strategy="ddp" if RANKS > 1 else "auto", **quiet,
    )  # fmt: skip


def run(way: str, names: dict[str, Any], path: str, saved: Path, workers: int, most: int) -> list[Any]:
    """Up to `most` steps, from what is saved."""
    data, step = dg.TransientDataset(path, ("histogram",), redraw_noise=True), Steps(most)
    try:
        if way == "lightning":
            lightning(names, data, step, saved.with_suffix(""), workers)
        elif way == "accelerate":
            names["train_accelerate"](data, step, saved, EPOCHS, names["accelerator"], workers)
        else:
            name = {"stateful": "train", "plain": "train_plain"}[way]
            names[name](data, step, saved.with_suffix(f".{RANK}"), EPOCHS, workers, RANK, RANKS)
    except StoppedHere:
        pass
    if distributed.is_initialized():
        distributed.barrier()
    return step.found


def main(way: str, path: str, out: str, workers: str) -> None:
    """Compare both runs, with a stop in the middle of the second epoch."""
    warnings.simplefilter("ignore")
    names: dict[str, Any] = {}
    for block in re.findall(r"^```python\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE):
        exec(compile(block, str(PAGE), "exec"), names)
    if way == "accelerate":
        from accelerate import Accelerator

        names["accelerator"] = Accelerator(cpu=True)
    elif RANKS > 1 and way != "lightning":
        distributed.init_process_group("gloo")
    steps = 6 // RANKS
    whole, first, rest = (
        run(way, names, path, Path(out) / name, int(workers), most)
        for name, most in (("whole.pt", -1), ("stopped.pt", steps + 2 // RANKS), ("stopped.pt", -1))
    )
    print(
        f"RESULT {len(whole)} steps, stopped after {len(first)}, {'the same' if first + rest == whole else 'other'}"
    )
    if distributed.is_initialized():
        distributed.destroy_process_group()


if __name__ == "__main__":
    main(*sys.argv[1:])
