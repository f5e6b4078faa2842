"""Texture strips of plain tubes, whose layout is known in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from vrcaps.organ.shape.strips import GAP, strip_coordinates

COLUMNS = 24


def tube_faces(radius: float, length: float, num_rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Way around and along of the faces of a tube, staggered so that faces cross every cut."""
    row, column = (part.ravel() for part in np.mgrid[:num_rows, :COLUMNS])
    step = length / num_rows
    corners = np.array([[[0, 0], [0, 1], [1, 1]], [[0, 0], [1, 1], [1, 0]]])
    rows = (row[:, None, None] + corners[..., 0]).reshape(-1, 3)
    columns = (column[:, None, None] + corners[..., 1]).reshape(-1, 3)
    bend = 0.6 * np.sin(2.0 * np.pi * columns / COLUMNS) * (rows > 0) * (rows < num_rows)
    return columns / COLUMNS, step * (rows + bend)


@pytest.mark.parametrize(
    ("radius", "length"), [(0.02, 0.1), (0.025, 1.9), (0.02, 2.5), (0.01, 5.0)]
)
def test_strips_make_a_row_that_is_nearly_square(radius: float, length: float):
    """Width n 2πR against height L / n: the best n is √(L / 2πR)."""
    turn, along = tube_faces(radius, length, 400)
    around = 2.0 * np.pi * radius
    uv = strip_coordinates(turn, along, np.full(turn.shape, radius), around * length)
    assert uv.min() > 0.0
    assert uv.max() < 1.0
    num_strips = max(1, round(np.sqrt(length / around)))
    pitch = 1.0 / num_strips
    strip = np.floor(uv[..., 0] / pitch)
    assert np.all(np.ptp(strip, axis=1) == 0.0)
    assert set(np.unique(strip)) == set(range(num_strips))
    # Within a strip the layout is the unrolled tube: the same scale everywhere.
    metres = num_strips * (around + GAP)
    assert np.allclose(uv[..., 0] * metres, (strip + turn) * around + (strip + 0.5) * GAP)
    one, other = along[:, 1:] - along[:, :1], uv[:, 1:, 1] - uv[:, :1, 1]
    height = np.sum(one * one) / np.sum(one * other)
    assert np.allclose(other * height, one, atol=1e-9)
    assert length / num_strips + GAP - 1e-9 <= height < length / num_strips + GAP + 0.05


def test_a_strip_is_as_wide_as_its_part_of_the_tube():
    """A tube of two calibres: strip widths stand in the ratio of their circumferences."""
    turn, along = tube_faces(0.02, 1.0, 600)
    radius = np.where(along < 0.5, 0.03, 0.01)
    uv = strip_coordinates(turn, along, radius, 2.0 * np.pi * 0.02 * 1.0)
    widths = [
        np.ptp(uv[is_in, :, 0], axis=1).max()
        for is_in in (along.max(axis=1) < 0.3, along.min(axis=1) > 0.7)
    ]
    assert widths[0] == pytest.approx(3.0 * widths[1], rel=1e-6)


def test_gaps_keep_the_padding_of_neighbouring_strips_apart():
    """Any two faces of different strips are a gap apart, and half a gap from the border."""
    turn, along = tube_faces(0.02, 2.0, 500)
    area = 2.0 * np.pi * 0.02 * 2.0
    uv = strip_coordinates(turn, along, np.full(turn.shape, 0.02), area)
    num_strips = round(np.sqrt(area) / (2.0 * np.pi * 0.02))
    metres = num_strips * (2.0 * np.pi * 0.02 + GAP)
    order = np.argsort(uv[..., 0].min(axis=1))
    low = uv[order, :, 0].min(axis=1)
    high = np.maximum.accumulate(uv[order, :, 0].max(axis=1))
    gaps = (low[1:] - high[:-1])[low[1:] > high[:-1] + 1e-9] * metres
    assert len(gaps) == num_strips - 1
    assert np.allclose(gaps, GAP)
    assert min(low[0], 1.0 - high[-1]) * metres == pytest.approx(0.5 * GAP)
