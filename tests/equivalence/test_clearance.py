"""Proofs that a line of sight is clear, compared with rays: never wrong, and frequent enough to pay."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from rooms import demonstration_room, furnished_box

from datagen import Scene
from datagen.transport.visibility.clearance import (
    flat_patch,
    pyramids_clear,
)
from datagen.transport.visibility.raycast import Raycaster


@pytest.mark.parametrize(
    ("scene", "on_wall", "normal"),
    [
        (furnished_box(), np.array([0, 0.2, 1.4]), np.array([1.0, 0, 0])),
        (demonstration_room()[0], np.array([6.0, 0.2, 1.4]), np.array([-1.0, 0, 0])),
    ],
    ids=["box", "demonstration"],
)
def test_proofs_of_clear_sight_are_never_wrong(
    scene: Scene, on_wall: NDArray[np.float64], normal: NDArray[np.float64]
) -> None:
    """Rays confirm every proof by pyramids, and most clear lines of sight are proven."""
    caster = Raycaster(scene)
    rng = np.random.default_rng(4)
    hits = caster.closest(on_wall + 1.3 * normal, rng.normal(size=(40_000, 3)))
    keep = hits.valid
    position, facing = hits.position[keep], hits.normal[keep]
    # Triangles seen from elsewhere may face the point on the wall or not: only those that face it can be lit.
    front = (np.einsum("nk,nk->n", on_wall - position, facing) > 1e-6) & ((position - on_wall) @ normal > 1e-6)
    position, facing = position[front], facing[front]
    fov = on_wall + np.column_stack([np.zeros(64), rng.uniform(-0.4, 0.4, (64, 2))])
    patch = flat_patch(fov, np.tile(normal, (64, 1)), caster.offset_m)
    assert patch is not None
    apexes, lifted = position[:400], position[:400] + caster.offset_m * facing[:400]
    clear = pyramids_clear(apexes, patch, caster.corners, caster.face_normal, caster.offset_m)
    ends = np.tile(fov + 1e-5 * normal, (len(apexes), 1))
    seen = ~caster.occluded(np.repeat(lifted, 64, axis=0), ends).reshape(-1, 64)
    faces_patch = (np.repeat(apexes, 64, axis=0).reshape(-1, 64, 3) - fov) @ normal > 1e-4
    assert seen[clear][faces_patch[clear]].all()
    assert clear.sum() > 0.7 * seen.all(axis=1).sum()
    assert flat_patch(np.vstack([fov, fov[0] + 0.1 * normal]), np.tile(normal, (65, 1)), caster.offset_m) is None
