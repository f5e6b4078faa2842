"""Flat chessboard as calibration target, and its inner corners in photographs.

Corners are refined to the saddle point of the brightness around them.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy

from vrcaps.core.errors import InputError, import_extra, require
from vrcaps.core.processes import ProgressReport, no_report

if TYPE_CHECKING:
    from jaxtyping import Float, UInt8

    from vrcaps.camera.camera import Camera
    from vrcaps.tools.photos import Photo

MIN_SQUARES, MAX_SQUARES = 4, 100
"""Squares along a side: fewer have too few inner corners to distinguish from other patterns."""

_SIZE = re.compile(r"\s*(\d+)\s*[x×]\s*(\d+)\s*")


@dataclass(frozen=True)
class Board:
    """Chessboard. Its frame: x along columns, y along rows, z into the board.

    The origin is the first inner corner. The grid of a chessboard is its own mirror image, so a
    mirroring camera gives the same fit.

    Attributes:
        columns: Squares along x.
        rows: Squares along y.
        square: Side of a square [m].
    """

    columns: int
    rows: int
    square: float

    def __post_init__(self) -> None:
        allowed = f"{MIN_SQUARES} to {MAX_SQUARES} squares along each side"
        for count in (self.columns, self.rows):
            fits = MIN_SQUARES <= count <= MAX_SQUARES
            require(fits, "The board", f"{self.columns}x{self.rows} squares", allowed)
        require(
            math.isfinite(self.square) and self.square > 0.0,
            "The side of a square",
            f"{self.square:g} m",
            "above 0",
        )

    @property
    def grid(self) -> tuple[int, int]:
        """Number of inner corners along columns and rows."""
        return self.columns - 1, self.rows - 1

    @property
    def points(self) -> Float[np.ndarray, "n 3"]:
        """Inner corners in the board's frame [m], row by row."""
        i, j = np.meshgrid(*(np.arange(count) for count in self.grid))
        return self.square * np.stack([i, j, np.zeros_like(i)], axis=-1).reshape(-1, 3)


def parse_board(text: str, square: float) -> Board:
    """Parse a board from its number of squares along both sides, such as ``7x8``.

    Args:
        text: Number of squares, not of inner corners.
        square: Side of a square [m].

    Raises:
        InputError: If the text has another form or no such board is possible.
    """
    match = _SIZE.fullmatch(text)
    if match is None:
        raise InputError(
            f"The board is {text!r}. Allowed: squares along its sides, for example 7x8."
        )
    return Board(int(match[1]), int(match[2]), square)


def board_image(
    camera: Camera, T_camera_board: Float[np.ndarray, "4 4"], board: Board, supersampling: int = 8
) -> Float[np.ndarray, "h w"]:
    """Render an evenly lit board with exact rays: 0 is black, 1 is white paper.

    Args:
        camera: Provides the lens, size and image circle.
        T_camera_board: Pose of the board.
        board: Drawn on white paper of infinite extent.
        supersampling: Rays along each side of a pixel.
    """
    from vrcaps.camera.camera import camera_rays

    rays = camera_rays(camera, supersampling).astype(float)
    rotation, origin = T_camera_board[:3, :3], T_camera_board[:3, 3]
    with np.errstate(invalid="ignore", divide="ignore"):
        distance = (rotation[:, 2] @ origin) / (rays @ rotation[:, 2])
        hits = (rays * distance[..., None] - origin) @ rotation[:, :2]
        cell = np.floor(hits / board.square + 1.0)
        on_board = np.all((cell >= 0) & (cell < (board.columns, board.rows)), axis=-1)
        black = on_board & (cell.sum(axis=-1) % 2 == 0)
        value = np.where(distance > 0.0, np.where(black, 0.0, 1.0), 0.0)
    shape = (camera.height, supersampling, camera.width, supersampling)
    return value.reshape(shape).mean(axis=(1, 3))


_REACH = 0.35
"""Radius of the window around a corner, as a fraction of the distance to the nearest neighbor."""
_MIN_RADIUS, _MAX_RADIUS = 2.0, 15.0
"""Min and max radius of the window [px]: small ones see pixels, large ones the lens's curves."""
_SAMPLES = 13
"""Samples across a window."""
_BLUR = 0.7
"""Standard deviation of the blur beforehand [px]; that of a square pixel is 0.29."""
_ROUNDS = 6
_FLAT = 1.0
"""Minimum curvature of a saddle: a gray level over the window's radius, squared."""


def refine_corners(
    gray: Float[np.ndarray, "h w"], grid: Float[np.ndarray, "r c 2"]
) -> Float[np.ndarray, "r c 2"]:
    """Move each corner to the saddle point of a quadratic fitted to the brightness around it.

    Where four squares meet, ``z = a x² + b xy + c y² + d x + e y + f`` fits the blurred
    brightness, and the corner is where its gradient is zero (Lucchese and Mitra, APCCAS 2002).
    Samples weigh less towards the window's rim. A corner is not moved if there is no saddle, or if
    it is farther away than the window's radius.

    Args:
        gray: Brightness of the photograph.
        grid: Corners (column, row) [px], arranged as on the board.
    """
    smooth = scipy.ndimage.gaussian_filter(gray.astype(float), _BLUR)
    radius = np.clip(_REACH * nearest_neighbors(grid), _MIN_RADIUS, _MAX_RADIUS).reshape(-1)
    step = np.linspace(-1.0, 1.0, _SAMPLES)
    x, y = (part.ravel() for part in np.meshgrid(step, step))
    weight = np.exp(-2.0 * (x**2 + y**2)) * (np.hypot(x, y) <= 1.0)
    terms = np.stack([x * x, x * y, y * y, x, y, np.ones_like(x)], axis=-1)
    solver = np.linalg.pinv(terms * weight[:, None]) * weight
    start = grid.reshape(-1, 2)
    corners, stays = start.copy(), np.zeros(len(start), bool)
    for _ in range(_ROUNDS):
        at = corners[:, None] + radius[:, None, None] * np.stack([x, y], axis=-1)
        values = scipy.ndimage.map_coordinates(smooth, np.moveaxis(at, -1, 0)[::-1], mode="nearest")
        a, b, c, d, e, _ = (values @ solver.T).T
        bend = 4.0 * a * c - b * b  # determinant of the Hessian, negative at a saddle
        stays |= bend > -_FLAT
        bend = np.minimum(bend, -_FLAT)
        move = np.stack([b * e - 2.0 * c * d, b * d - 2.0 * a * e], axis=-1) / bend[:, None]
        corners = corners + np.clip(move, -0.5, 0.5) * radius[:, None]
        stays |= np.linalg.norm(corners - start, axis=1) > radius
        corners = np.where(stays[:, None], start, corners)
    return corners.reshape(grid.shape)


def nearest_neighbors(grid: Float[np.ndarray, "r c 2"]) -> Float[np.ndarray, "r c"]:
    """Distance of each corner to the nearest of its neighbors along rows and columns [px]."""
    nearest = np.full(grid.shape[:2], np.inf)
    for axis in (0, 1):
        apart = np.linalg.norm(np.diff(grid, axis=axis), axis=-1)
        before = [(0, 0), (0, 0)]
        after = [(0, 0), (0, 0)]
        before[axis], after[axis] = (1, 0), (0, 1)
        for pad in (before, after):
            nearest = np.minimum(nearest, np.pad(apart, pad, constant_values=np.inf))
    return nearest


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
    photos: Sequence[Photo], board: Board, progress: ProgressReport = no_report
) -> tuple[list[BoardView], list[str]]:
    """Detect the board in each photograph; return the views and the names of photographs without.

    Args:
        photos: Of one camera.
        board: Board to search for.
        progress: Called with the count done and the total.

    Raises:
        InputError: If photographs differ in size, fewer than `MIN_VIEWS` show the board, or the
            detected board is part of a larger one.
        MissingExtraError: If OpenCV is not installed.
    """
    _check_sizes(photos)
    views, missed = [], []
    for k, photo in enumerate(photos):
        corners = find_corners(photo.rgb, board)
        if corners is None:
            missed.append(photo.name)
        else:
            views.append(BoardView(photo.name, *corners))
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
        is_detected, corners = detect(image, board.grid)
        if is_detected:
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
        marked = [
            photo.name
            for photo in photos
            if cv2.findChessboardCornersSB(
                cv2.cvtColor(photo.rgb, cv2.COLOR_RGB2GRAY), larger.grid
            )[0]
        ]
        if marked and 2 * len(marked) >= len(photos):
            raise InputError(
                f"The board in {marked[0]} is larger than {board.columns}x{board.rows} squares. "
                f"Allowed: all its squares, here {columns}x{rows} or more; count squares, not "
                "inner corners."
            )


def _opencv() -> Any:
    return import_extra("cv2", "calibrate", package="opencv-python-headless")
