"""Which pixels of an image are asked, and what the others get: against fields that are known everywhere."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from datagen.evidence.image import first_step, refined

ROWS, COLUMNS = 37, 50
ROW, COLUMN = np.mgrid[:ROWS, :COLUMNS]


def image_of(
    field: Callable[[np.ndarray, np.ndarray], np.ndarray], step: int, bent: np.ndarray | None = None,
    there: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """The image (rows, columns) of a field of one station seen on a plane, or where that is bent; and how often each
    pixel was asked."""
    asked = np.zeros((ROWS, COLUMNS), int)

    def ask(pixel: np.ndarray, station: np.ndarray) -> np.ndarray:
        assert not station.any()
        np.add.at(asked.reshape(-1), pixel, 1)
        row, column = np.divmod(pixel, COLUMNS)
        return field(row, column)

    depth = np.zeros((ROWS, COLUMNS)) if bent is None else 0.1 * bent
    position = np.stack([ROW, COLUMN, depth], axis=-1).astype(np.float64)
    normal = np.broadcast_to([0.0, 0.0, 1.0], position.shape).copy()
    seen = np.ones((ROWS, COLUMNS), bool) if there is None else there
    part = np.where(seen, 0, -1)
    return refined(ask, seen, position, normal, part, 1, step)[..., 0], asked


def smooth(row: np.ndarray, column: np.ndarray) -> np.ndarray:
    return 5.0 + 0.02 * row + 0.03 * column + 1e-4 * row * column


def shadow(row: np.ndarray, column: np.ndarray) -> np.ndarray:
    return np.where(row + 0.7 * column > 40, smooth(row, column), 0.0)


def test_what_is_bilinear_is_exact_from_the_corners() -> None:
    found, asked = image_of(smooth, 4)
    assert np.allclose(found, smooth(ROW, COLUMN), rtol=1e-12)
    # Every fourth, and the last.
    assert asked.sum() == 10 * 14


@pytest.mark.parametrize("step", [1, 2, 4, 8])
def test_a_shadow_wider_than_a_block_has_its_edge_where_it_is(step: int) -> None:
    found, asked = image_of(shadow, step)
    assert np.allclose(found, shadow(ROW, COLUMN), rtol=1e-12)
    assert asked.max() == 1 and (step > 1) == (asked.sum() < asked.size)


def test_every_pixel_is_asked_where_surfaces_are_bent_or_change() -> None:
    bent = np.where(COLUMN > 20, (COLUMN - 20.0) ** 2, 0.0)
    _, asked = image_of(smooth, 4, bent)
    assert (asked[:, 24:] == 1).all() and asked[:, :20].mean() < 0.1


def test_what_falls_fast_is_halved() -> None:
    found, asked = image_of(lambda row, column: np.exp(-0.5 * column), 4)
    # The last block is one pixel wide.
    assert (asked[:, :48] == 1).all() and np.allclose(found, np.exp(-0.5 * COLUMN), rtol=1e-12)


def test_where_nothing_is_seen_nobody_asks() -> None:
    there = COLUMN > 30
    found, asked = image_of(smooth, 4, there=there)
    assert not found[~there].any() and not asked[~there].any() and (found[there] > 0).all()


def test_small_images_are_asked_whole() -> None:
    assert [first_step(n, 200) for n in (1, 16, 31, 32, 64, 128, 1000)] == [1, 1, 1, 2, 4, 8, 8]
