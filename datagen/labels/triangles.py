"""What points and rays meet of a set of triangles, by Open3D's `RaycastingScene` (embree, single precision).

All coordinates are those of the label frame, whose origin lies in the middle of the hidden view: rounding is some
10⁻⁷ of the distance from there. Everything runs in one thread, so that embree's tree, and with it the one of two
surfaces in one place that a ray meets, is the same for any number of workers.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from datagen.errors import InputError
from datagen.records.arrays import Bools, Floats, Ints
from scene_library.open3d_import import import_open3d

_THREADS = 1


class Triangles:
    """Triangles with corners (F, 3, 3), metres. Raises `InputError` where Open3D cannot be loaded."""

    def __init__(self, corners: Floats) -> None:
        open3d = open3d_for_labels()
        self._tensor = open3d.core.Tensor
        self._scene = open3d.t.geometry.RaycastingScene(nthreads=_THREADS)
        if len(corners):
            numbers = np.arange(3 * len(corners), dtype=np.uint32).reshape(-1, 3)
            self._scene.add_triangles(self._single(corners.reshape(-1, 3)), self._tensor(numbers))

    def _single(self, values: Floats) -> Any:
        return self._tensor(np.ascontiguousarray(values, np.float32))

    def _rays(self, origins: Floats, directions: Floats) -> Any:
        rays = np.empty((len(origins), 6), np.float32)
        rays[:, :3], rays[:, 3:] = origins, directions
        return self._tensor(rays)

    def distances(self, points: Floats) -> NDArray[np.float32]:
        """(…,) metres from points (…, 3) to the nearest triangle."""
        found: NDArray[np.float32] = self._scene.compute_distance(self._single(points), nthreads=_THREADS).numpy()
        return found

    def first_met(self, origins: Floats, directions: Floats) -> Ints:
        """(n,) number of the triangle that each ray meets first, −1 for none."""
        met = self._scene.cast_rays(self._rays(origins, directions), nthreads=_THREADS)["primitive_ids"].numpy()
        return np.where(met == np.iinfo(np.uint32).max, -1, met.astype(np.int64))

    def blocked(self, starts: Floats, ends: Floats) -> Bools:
        """(n,) whether a triangle cuts the segment from start to end."""
        found = self._scene.test_occlusions(self._rays(starts, ends - starts), tfar=1.0, nthreads=_THREADS)
        return np.asarray(found.numpy())


def open3d_for_labels() -> Any:
    """The module `open3d`; raises `InputError` where it cannot be loaded."""
    try:
        return import_open3d()
    except ImportError as error:
        raise InputError(f"labels: images and volumes need {error}, or leave them out of store.fields") from None


def plane_depths(corners: Floats, numbers: Ints, at: Floats) -> Floats:
    """(n,) third coordinate of planes where the first two are `at` (n, 2), in double precision, within those of the
    corners: the plane of a steep triangle leaves them by rounding.

    corners : (F, 3, 3) of triangles. numbers : (n,) those of the triangles in the planes.
    """
    low, high = corners[..., 2].min(axis=1), corners[..., 2].max(axis=1)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[numbers]
    rise = np.einsum("nk,nk->n", normal[:, :2], at - corners[numbers, 0, :2])
    # A triangle seen edge on is met by rounding only, and any of its depths will do.
    slope = np.divide(rise, normal[:, 2], out=np.zeros(len(rise)), where=normal[:, 2] != 0)
    return np.asarray(np.clip(corners[numbers, 0, 2] - slope, low[numbers], high[numbers]))
