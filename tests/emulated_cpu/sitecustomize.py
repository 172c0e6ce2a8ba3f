"""Makes embree use the instruction set named in DATAGEN_EMBREE_ISA; `tests/cpu_types.py` puts this on the path.

embreex offers no choice, so the device of each scene is exchanged for one made by embree itself with `isa=…`.
"""

from __future__ import annotations

import ctypes
import importlib.abc
import importlib.machinery
import importlib.util
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

USERS = {"datagen.transport.visibility.raycast", "scene_library.sightlines"}
RAY8_SUPPORTED, RAY16_SUPPORTED = 33, 34
"""RTC_DEVICE_PROPERTY_NATIVE_RAY8_SUPPORTED and …_RAY16_SUPPORTED: whether AVX and AVX-512 are in use."""
DEVICE_AT = object.__basicsize__
"""Where an EmbreeDevice keeps its RTCDevice: its only field."""


def device_with(isa: str) -> Any:
    """An `embreex.rtcore.EmbreeDevice` that uses the instruction set `isa`, such as "sse4.2" or "avx2"."""
    from embreex import rtcore

    library = next(Path(rtcore.__file__).parents[1].glob("embreex.libs/libembree*"))
    embree = ctypes.CDLL(str(library))
    embree.rtcNewDevice.restype, embree.rtcNewDevice.argtypes = ctypes.c_void_p, [ctypes.c_char_p]
    embree.rtcGetDeviceProperty.restype = ctypes.c_ssize_t
    embree.rtcGetDeviceProperty.argtypes = [ctypes.c_void_p, ctypes.c_int]
    made = embree.rtcNewDevice(f"isa={isa}".encode())
    wide = [bool(embree.rtcGetDeviceProperty(made, which)) for which in (RAY8_SUPPORTED, RAY16_SUPPORTED)]
    if not made or wide != [isa.startswith("avx"), isa == "avx512"]:
        raise RuntimeError(f"embree does not use isa={isa}")
    device = rtcore.EmbreeDevice()
    ctypes.c_void_p.from_address(id(device) + DEVICE_AT).value = made
    return device


class _Patching(importlib.abc.MetaPathFinder):
    """Lets the modules that make embree scenes be imported as ever, then hands them scenes with our device."""

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        if name not in USERS:
            return None
        USERS.remove(name)
        spec = importlib.util.find_spec(name)
        assert spec is not None and spec.loader is not None
        run = spec.loader.exec_module

        def exec_module(module: Any) -> None:
            run(module)
            scene, device = module.EmbreeScene, device_with(os.environ["DATAGEN_EMBREE_ISA"])
            module.EmbreeScene = lambda: scene(device)

        spec.loader.exec_module = exec_module  # type: ignore[method-assign]
        return spec


if os.environ.get("DATAGEN_EMBREE_ISA"):
    sys.meta_path.insert(0, _Patching())
