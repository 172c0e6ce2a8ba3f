"""What a mesh file gives: its surface, or a line that says why there is none."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scene_library.arrays import Floats


class BadMesh(ValueError):
    """A file that cannot be used: the message says what is wrong with it and what to do."""


@dataclass(frozen=True)
class MeshFile:
    """The surface of a file.

    Attributes
    ----------
    vertices, triangles : (V, 3) and (F, 3), in the file's coordinates.
    doubt : what the file leaves open, in a line for users; "" where nothing.
    """

    vertices: Floats
    triangles: NDArray[np.int64]
    doubt: str = ""
