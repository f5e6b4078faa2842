"""Chessboards as data and exact pictures, and their corners in photographs."""

from __future__ import annotations

import math
import sys
from dataclasses import replace

import numpy as np
import pytest

from tests.support.boards import corners, held
from vrcaps.camera.lens import LensKannalaBrandt
from vrcaps.capsule.device_file import read_device
from vrcaps.core.errors import InputError, MissingExtraError
from vrcaps.tools.camera_calibration.board import (
    Board,
    board_image,
    find_corners,
    find_views,
    nearest_neighbors,
    parse_board,
    refine_corners,
)
from vrcaps.tools.photos import Photo


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


BOARD = Board(7, 8, 2e-3)
CAMERA = replace(
    read_device("mirocam").cameras[0],
    lens=LensKannalaBrandt(75.0, 75.0, 79.0, 80.0, k1=0.03),
    width=160,
    height=160,
    image_circle_px=None,
)


def picture(pose: np.ndarray, board: Board = BOARD) -> np.ndarray:
    """8-bit gray as three channels, ink at 30 and paper at 220."""
    gray = np.rint(30.0 + 190.0 * board_image(CAMERA, pose, board, 4)).astype(np.uint8)
    return np.repeat(gray[..., None], 3, axis=2)


@pytest.fixture(scope="module")
def poses() -> np.ndarray:
    return held(CAMERA, BOARD, 3, np.random.default_rng(2), tilt=0.3)


@pytest.fixture(scope="module")
def pictures(poses: np.ndarray) -> list[np.ndarray]:
    return [picture(pose) for pose in poses]


def nearest(found: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Offsets of corners from the nearest true ones; each true one is met once."""
    index = np.linalg.norm(found[:, None] - true, axis=-1).argmin(axis=1)
    assert sorted(index) == list(range(len(true)))
    return found - true[index]


@pytest.mark.slow
def test_corners_are_found_to_a_twentieth_of_a_pixel_without_bias(poses, pictures) -> None:
    for pose, rgb in zip(poses, pictures, strict=True):
        found = find_corners(rgb, BOARD)
        assert found is not None
        offset = nearest(found[0], corners(CAMERA, pose[None], BOARD)[0])
        assert np.median(np.linalg.norm(offset, axis=1)) < 0.05
        assert np.abs(offset.mean(axis=0)).max() < 0.02


@pytest.mark.slow
def test_a_mirrored_picture_has_the_same_corners_mirrored(pictures) -> None:
    """And they run the same way around as columns and rows: x of the grid across y."""
    last = CAMERA.width - 1
    for rgb in pictures:
        plain, mirrored = find_corners(rgb, BOARD), find_corners(rgb[:, ::-1].copy(), BOARD)
        assert plain is not None
        assert mirrored is not None
        back = mirrored[0] * (-1.0, 1.0) + (last, 0.0)
        assert np.abs(nearest(back, plain[0])).max() < 0.02
        for found, _ in (plain, mirrored):
            grid = found.reshape(7, 6, 2)
            (a, b), (c, d) = grid[0, 1] - grid[0, 0], grid[1, 0] - grid[0, 0]
            assert a * d - b * c > 0.0


def test_refining_finds_the_saddle_of_a_quadratic() -> None:
    """On ``(x - u) (y - v)`` blurred, whose saddle is at (u, v), from half a pixel away."""
    rng = np.random.default_rng(0)
    true = np.array([[[20.3, 20.8], [44.6, 20.1]], [[20.9, 44.2], [44.0, 44.7]]])
    y, x = np.mgrid[:64, :64].astype(float)
    index = np.hypot(x[..., None] - true[..., 0].ravel(), y[..., None] - true[..., 1].ravel())
    u, v = np.moveaxis(true.reshape(-1, 2)[index.argmin(axis=-1)], -1, 0)
    start = true + rng.uniform(-0.5, 0.5, true.shape)
    found = refine_corners(128.0 + 0.3 * (x - u) * (y - v), start)
    np.testing.assert_allclose(found, true, atol=2e-5)  # the blur's cut-off tails


def test_corners_stay_where_there_is_no_saddle() -> None:
    y, x = np.mgrid[:64, :64].astype(float)
    start = np.array([[[20.0, 20.0], [40.0, 20.0]], [[20.0, 40.0], [40.0, 40.0]]])
    np.testing.assert_array_equal(refine_corners((x - 30) ** 2 + (y - 30) ** 2, start), start)
    np.testing.assert_array_equal(refine_corners(np.full((64, 64), 9.0), start), start)


def test_distance_to_the_nearest_neighbor() -> None:
    grid = np.array([[[0.0, 0.0], [3.0, 0.0], [10.0, 0.0]], [[0.0, 5.0], [4.0, 5.0], [10.0, 4.0]]])
    expected = [[3.0, 3.0, 4.0], [4.0, 4.0, 4.0]]
    np.testing.assert_allclose(nearest_neighbors(grid), expected, atol=1e-12)


@pytest.mark.slow
def test_photographs_without_a_board_are_named_and_too_few_are_an_error(pictures) -> None:
    ramp = np.linspace(40.0, 200.0, CAMERA.width).astype(np.uint8)
    empty = Photo("empty", np.broadcast_to(ramp[:, None], pictures[0].shape).copy())
    photos = [Photo(str(k), rgb) for k, rgb in enumerate(pictures)]
    calls = []
    views, missed = find_views([*photos, empty], BOARD, lambda *done: calls.append(done))
    assert [view.name for view in views] == ["0", "1", "2"]
    assert missed == ["empty"]
    assert calls == [(1, 4), (2, 4), (3, 4), (4, 4)]
    with pytest.raises(InputError, match=r"7x8 squares is seen in 2 of 3 photographs. Allowed: 3"):
        find_views([*photos[:2], empty], BOARD)
    small = Photo("small", empty.rgb[:80, :80])
    with pytest.raises(InputError, match="--board counts squares, not inner corners"):
        find_views([small] * 3, BOARD)
    for columns, rows in ((6, 7), (6, 8), (7, 7)):
        fewer = replace(BOARD, columns=columns, rows=rows)
        with pytest.raises(
            InputError, match=rf"larger than {columns}x{rows} squares\. Allowed: .* here (7x8|8x7)"
        ):
            find_views(photos, fewer)


def test_photographs_of_two_sizes_are_an_error(pictures) -> None:
    photos = [Photo("a", pictures[0]), Photo("b", pictures[1][:-1])]
    with pytest.raises(InputError, match=r"b has 160 × 159 px, a 160 × 160\. Allowed"):
        find_views(photos, BOARD)


def test_without_opencv_the_extra_is_named(pictures, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "cv2", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'vrcaps\[calibrate\]'"):
        find_corners(pictures[0], BOARD)
