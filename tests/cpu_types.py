"""The tests as older processors would run them: `python tests/cpu_types.py [pytest arguments]`.

Each type runs the whole of pytest in processes of its own, with the choice of instructions of numpy, numba, embree,
OpenBLAS and the C library held to what such a processor has, and prints one line: passed or failed. Exit status 1 if
any failed.
`--type NAME` before the arguments runs one type alone.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from numpy._core._multiarray_umath import __cpu_dispatch__, __cpu_features__

ROOT = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class CpuType:
    """Attributes
    ----------
    numba : LLVM's name of the processor.
    embree : widest instruction set of embree.
    blas : OpenBLAS's name of the processor.
    numpy : words in the names of those numpy features that it lacks, or ("",) for all beyond numpy's baseline.
    glibc : features that the C library's mathematics must not use.
    """

    numba: str
    embree: str
    blas: str
    numpy: tuple[str, ...]
    glibc: str


TYPES = {
    "nehalem": CpuType("nehalem", "sse4.2", "Nehalem", ("",), "-AVX,-AVX2,-FMA,-FMA4,-AVX512F"),
    "haswell": CpuType("haswell", "avx2", "Haswell", ("X86_V4", "AVX512"), "-AVX512F"),
}
"""2008, without AVX; 2013, with AVX2 and fused multiplication, without AVX-512."""


def environment(cpu: CpuType, caches: str) -> dict[str, str]:
    """The environment of a test run; `caches` is a folder for what numba compiles."""
    here = [name for name in __cpu_dispatch__ if __cpu_features__.get(name)]
    absent = [name for name in here if any(word in name for word in cpu.numpy)]
    path = [str(ROOT), str(ROOT / "tests" / "emulated_cpu"), os.environ.get("PYTHONPATH", "")]
    return os.environ | {
        "NPY_DISABLE_CPU_FEATURES": " ".join(absent),
        "NUMBA_CPU_NAME": cpu.numba,
        "NUMBA_CPU_FEATURES": "",
        "NUMBA_CACHE_DIR": caches,
        "DATAGEN_EMBREE_ISA": cpu.embree,
        "OPENBLAS_CORETYPE": cpu.blas,
        "GLIBC_TUNABLES": f"glibc.cpu.hwcaps={cpu.glibc}",
        "PYTHONPATH": os.pathsep.join(filter(None, path)),
    }


def main() -> int:
    chosen, arguments = list(TYPES), sys.argv[1:]
    if arguments[:1] == ["--type"]:
        chosen, arguments = [arguments[1]], arguments[2:]
    failed = 0
    for name in chosen:
        with tempfile.TemporaryDirectory() as caches:
            command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *arguments]
            began = time.monotonic()
            status = subprocess.run(command, cwd=ROOT, env=environment(TYPES[name], caches), check=False).returncode
        failed += status != 0
        outcome = "passed" if status == 0 else f"FAILED (pytest's exit status {status})"
        print(f"{name}: {outcome} in {time.monotonic() - began:.0f} s", flush=True)
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
