"""Inner corners of a chessboard in a photograph."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.core.errors import InputError, import_extra
from vrcaps.tools.camera_calibration.board import MAX_SQUARES, Board
from vrcaps.tools.camera_calibration.subpixel import refine_corners

if TYPE_CHECKING:
    from jaxtyping import Float, UInt8

    from vrcaps.tools.photos import Photo

MIN_VIEWS = 3
"""Minimum number of board views that determine a lens (Zhang, IEEE PAMI 22(11), 2000, sec. 3.1)."""
_NUM_CHECKED = 5
"""Photographs in which to search for a larger board."""


@dataclass(frozen=True)
class BoardView:
    """Chessboard detected in a photograph.

    Attributes:
        name: Name of the photograph.
        pixels: Its inner corners (column, row) [px], in the order of `Board.points`.
        method: Detection method: ``plain``, or the preprocessing that the photograph needed.
    """

    name: str
    pixels: Float[np.ndarray, "n 2"]
    method: str = "plain"


def find_views(
    photos: Sequence[Photo], board: Board, progress: Callable[[int, int], None] | None = None
) -> tuple[list[BoardView], list[str]]:
    """Detect the board in each photograph; return the views and the names of photographs without.

    Args:
        photos: Of one camera.
        board: Board to search for.
        progress: Called with the number done and the total.

    Raises:
        InputError: If photographs differ in size, fewer than `MIN_VIEWS` show the board, or the
            detected board is part of a larger one.
        MissingExtraError: If OpenCV is not installed.
    """
    _check_sizes(photos)
    views, missed = [], []
    for k, photo in enumerate(photos):
        found = find_corners(photo.rgb, board)
        if found is None:
            missed.append(photo.name)
        else:
            views.append(BoardView(photo.name, *found))
        if progress is not None:
            progress(k + 1, len(photos))
    names = {view.name for view in views[:_NUM_CHECKED]}
    _check_whole([photo for photo in photos if photo.name in names], board)
    if len(views) < MIN_VIEWS:
        raise InputError(
            f"The board of {board.columns}x{board.rows} squares is seen in {len(views)} of "
            f"{len(photos)} photographs. Allowed: {MIN_VIEWS} or more that show it whole. "
            "--board counts squares, not inner corners."
        )
    return views, missed


def find_corners(
    rgb: UInt8[np.ndarray, "h w 3"], board: Board
) -> tuple[Float[np.ndarray, "n 2"], str] | None:
    """Detect the inner corners of a board [px] in the order of `Board.points`, and name the method.

    The sector-based detector (Duda and Frese, BMVC 2018; OpenCV's `findChessboardCornersSB`) is
    tried on the photograph, mirrored, with even contrast and enlarged; then the classic detector.
    The first method that finds every corner is used; its corners are refined in the photograph.

    Raises:
        MissingExtraError: If OpenCV is not installed.
    """
    cv2 = _opencv()
    gray = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
    for method, image, detect, restore in _methods(cv2, gray):
        found, corners = detect(image, board.grid)
        if found:
            pixels = restore(np.asarray(corners, float).reshape(*board.grid[::-1], 2))
            return refine_corners(gray, _ordered(pixels)).reshape(-1, 2), method
    return None


def _methods(cv2: Any, gray: np.ndarray) -> Iterator[tuple[str, np.ndarray, Callable, Callable]]:
    """Name, image, detector, and map from the image's pixels to the photograph's, per method."""
    flags = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
    sectors = partial(cv2.findChessboardCornersSB, flags=flags)
    even = partial(sectors, flags=flags | cv2.CALIB_CB_NORMALIZE_IMAGE)
    yield "plain", gray, sectors, lambda pixels: pixels
    mirrored, last = np.ascontiguousarray(gray[:, ::-1]), gray.shape[1] - 1
    yield "mirrored", mirrored, sectors, lambda pixels: pixels * (-1.0, 1.0) + (last, 0.0)
    yield "even contrast", gray, even, lambda pixels: pixels
    large = cv2.resize(gray, None, fx=2.0, fy=2.0, interpolation=cv2.INTER_CUBIC)
    yield "enlarged", large, sectors, lambda pixels: (pixels + 0.5) / 2.0 - 0.5
    yield "classic detector", gray, cv2.findChessboardCorners, lambda pixels: pixels


def _ordered(grid: np.ndarray) -> np.ndarray:
    """Order corners so that x, y of the board turn like columns, rows of the photograph."""
    along, down = np.diff(grid, axis=1)[:-1], np.diff(grid, axis=0)[:, :-1]
    turn = along[..., 0] * down[..., 1] - along[..., 1] * down[..., 0]
    return grid if turn.sum() > 0.0 else grid[:, ::-1]


def _check_sizes(photos: Sequence[Photo]) -> None:
    height, width = photos[0].rgb.shape[:2]
    for photo in photos:
        rows, columns = photo.rgb.shape[:2]
        if (rows, columns) != (height, width):
            raise InputError(
                f"{photo.name} has {columns} × {rows} px, {photos[0].name} {width} × {height}. "
                "Allowed: photographs of one camera, all of one size."
            )


def _check_whole(photos: Sequence[Photo], board: Board) -> None:
    """Check that the detected boards are not parts of a larger one: too few squares given.

    A detector may occasionally see one square too many, so half of the photographs must show it.
    """
    cv2 = _opencv()
    for more_columns, more_rows in ((1, 1), (1, 0), (0, 1)):
        columns, rows = board.columns + more_columns, board.rows + more_rows
        if max(columns, rows) > MAX_SQUARES:
            continue
        larger = Board(columns, rows, board.square)
        shown = [
            photo.name
            for photo in photos
            if cv2.findChessboardCornersSB(
                cv2.cvtColor(photo.rgb, cv2.COLOR_RGB2GRAY), larger.grid
            )[0]
        ]
        if shown and 2 * len(shown) >= len(photos):
            raise InputError(
                f"The board in {shown[0]} is larger than {board.columns}x{board.rows} squares. "
                f"Allowed: all its squares, here {columns}x{rows} or more; count squares, not "
                "inner corners."
            )


def _opencv() -> Any:
    return import_extra("cv2", "calibrate", package="opencv-python-headless")
