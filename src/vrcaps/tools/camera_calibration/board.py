"""Flat chessboard used as calibration target."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import InputError, require

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.camera.camera import Camera

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
