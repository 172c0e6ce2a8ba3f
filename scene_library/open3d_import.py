"""Open3D, imported where it is first used: that takes a second and 60 MB, and needs packages of the system."""

from __future__ import annotations

from typing import Any


def import_open3d() -> Any:
    """The module `open3d`. Raises `ImportError`, which names the system packages it needs, if it cannot be loaded."""
    try:
        import open3d
    except (ImportError, OSError) as error:
        raise ImportError(
            f"Open3D, which cannot be loaded ({' '.join(str(error).split())[:100]}): install libusb-1.0-0 libgl1 "
            "libegl1 libx11-6 libgomp1 (docker/system-packages.txt)"
        ) from None
    return open3d
