"""A board as data, and its exact picture."""

from __future__ import annotations

import math

import numpy as np
import pytest

from boards import corners, held
from vrcaps.capsule.catalog import read_device
from vrcaps.core.errors import InputError
from vrcaps.tools.camera_calibration.board import Board, board_image, parse_board


def test_inner_corners_run_along_rows() -> None:
    board = parse_board(" 5x4 ", 0.002)
    assert board == Board(5, 4, 0.002)
    assert board.grid == (4, 3)
    np.testing.assert_allclose(board.points[0], 0.0)
    np.testing.assert_allclose(board.points[1], [0.002, 0.0, 0.0])
    np.testing.assert_allclose(board.points[4], [0.0, 0.002, 0.0])
    assert len(board.points) == 12


@pytest.mark.parametrize("text", ["7", "7x", "7x8x9", "seven by eight", "-7x8", "7.5x8", ""])
def test_a_board_of_another_form_is_an_error(text: str) -> None:
    with pytest.raises(InputError, match="Allowed: squares along its sides, for example 7x8"):
        parse_board(text, 0.002)


@pytest.mark.parametrize("text", ["3x8", "7x0", "7x101"])
def test_a_board_that_cannot_be_is_an_error(text: str) -> None:
    with pytest.raises(InputError, match=f"The board is {text} squares. Allowed: 4 to 100 squares"):
        parse_board(text, 0.002)


@pytest.mark.parametrize("square", [0.0, -0.002, math.nan, math.inf])
def test_a_square_without_a_size_is_an_error(square: float) -> None:
    with pytest.raises(InputError, match=r"The side of a square is .* m\. Allowed: above 0"):
        parse_board("7x8", square)


def test_squares_around_an_inner_corner_alternate_in_the_picture() -> None:
    """Half-way to its neighbors' middle, each corner sees two black and two white squares."""
    camera = read_device("mono").cameras[0]
    board = Board(6, 5, 2e-3)
    pose = held(camera, board, 1, np.random.default_rng(2), tilt=0.3)
    image = board_image(camera, pose[0], board, 2)
    grid = corners(camera, pose, board)[0].reshape(4, 5, 2)
    middles = 0.25 * (grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:] + grid[1:, 1:])
    column, row = np.moveaxis(np.rint(middles).astype(int), -1, 0)
    rows, columns = np.indices(column.shape)
    # The square between the first four corners is the second along both sides: black, as the first.
    np.testing.assert_array_equal(image[row, column], (rows + columns) % 2)
