"""Sparse reconstruction: wall points visible in images, with their pixels in every image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.camera.camera import in_image, pixel_grid, project_points, unproject_pixels
from vrcaps.core import rng
from vrcaps.core.transforms import invert, transform_points
from vrcaps.recording.frame_sequence import FrameSequence

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int, UInt8

    from vrcaps.camera.camera import Camera

_SLACK, _STEP = 1e-3, 2e-5
"""Tolerance of a visible point's depth from the surrounding pixels: a fraction, and [m]."""


@dataclass(frozen=True)
class SeenPoints:
    """Points of the wall with their observations.

    Attributes:
        positions: In the world frame [m].
        colors: sRGB of the pixel that each was sampled at.
        seen: Indices [m] of the points and their pixels [m 2], for each camera and frame.
    """

    positions: Float[np.ndarray, "n 3"]
    colors: UInt8[np.ndarray, "n 3"]
    seen: list[list[tuple[Int[np.ndarray, " m"], Float[np.ndarray, "m 2"]]]]


def seen_points(sequences: Sequence[FrameSequence], count: int) -> SeenPoints:
    """Sample points at pixels of all images and keep those visible in two or more images.

    A point is visible if its z lies within the depths of the four surrounding pixels.

    Args:
        sequences: Cameras of one capsule, with rgb and depth unless `count` is 0.
        count: Number of sampled points; most are seen twice if the capsule moves slowly.
    """
    images = sum(map(len, sequences))
    found = [
        _drawn(sequence, k, -(-count // images))
        for sequence in sequences
        for k in range(len(sequence) if count > 0 else 0)
    ]
    positions = np.concatenate([np.zeros((0, 3)), *(points for points, _ in found)])
    colors = np.concatenate([np.zeros((0, 3), np.uint8), *(color for _, color in found)])
    if count == 0:
        nothing = np.zeros(0, int), np.zeros((0, 2))
        return SeenPoints(positions, colors, [[nothing] * len(one) for one in sequences])
    seen = [[_seen(one, k, positions) for k in range(len(one))] for one in sequences]
    everywhere = np.concatenate([each for row in seen for each, _ in row])
    kept = np.bincount(everywhere, minlength=len(positions)) >= 2
    number = np.cumsum(kept) - 1
    tracks = [[(number[each[kept[each]]], at[kept[each]]) for each, at in row] for row in seen]
    return SeenPoints(positions[kept], colors[kept], tracks)


def _drawn(sequence: FrameSequence, index: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Points [m] and colors of pixels sampled from an image."""
    camera = _camera(sequence)
    depth, rgb = sequence.image("depth", index), sequence.image("rgb", index)
    rows, columns = np.nonzero(depth > 0.0)
    draw = rng.stream(0, f"formats/seen_points/{camera.name}/{index}")
    chosen = draw.permutation(len(rows))[:count]
    rows, columns = rows[chosen], columns[chosen]
    rays = unproject_pixels(camera, pixel_grid(camera.width, camera.height)[rows, columns])
    points = rays * (depth[rows, columns] / rays[:, 2])[:, None]
    return transform_points(sequence.Ts_world_camera[index], points), rgb[rows, columns]


def _seen(
    sequence: FrameSequence, index: int, positions: Float[np.ndarray, "n 3"]
) -> tuple[Int[np.ndarray, " m"], Float[np.ndarray, "m 2"]]:
    camera = _camera(sequence)
    points = transform_points(invert(sequence.Ts_world_camera[index]), positions)
    pixels = project_points(camera, points)
    inside = np.flatnonzero(in_image(camera, pixels) & (points[:, 2] > 0.0))
    near = _is_at_depth(sequence.image("depth", index), pixels[inside], points[inside, 2])
    found = inside[near]
    return found, pixels[found]


def _is_at_depth(
    depth: Float[np.ndarray, "h w"], pixels: Float[np.ndarray, "n 2"], z: Float[np.ndarray, " n"]
) -> Bool[np.ndarray, " n"]:
    """Whether z lies within the depths of the four pixels around each position."""
    height, width = depth.shape
    corners = []
    for step in (np.floor, np.ceil):
        for other in (np.floor, np.ceil):
            column = step(pixels[:, 0]).astype(int).clip(0, width - 1)
            row = other(pixels[:, 1]).astype(int).clip(0, height - 1)
            corners.append(depth[row, column])
    known = np.isfinite(corners)
    nearest = np.where(known, corners, np.inf).min(axis=0)
    farthest = np.where(known, corners, -np.inf).max(axis=0)
    slack = _SLACK * z + _STEP
    return (z >= nearest - slack) & (z <= farthest + slack)


def _camera(sequence: FrameSequence) -> Camera:
    assert sequence.camera is not None
    return sequence.camera
