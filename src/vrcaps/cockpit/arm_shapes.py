"""Arm shapes: meshes of a robot arm's links, from its description package or from its capsules."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import trimesh
    from jaxtyping import Float, Int

    from vrcaps.actuation.arm.arm import Arm

_PACKAGE = "share/example-robot-data/robots/{arm}_description/meshes/collision/link{number}.stl"
"""Path of an arm's links in the package example-robot-data. The frames of the Panda's links are
those of its Denavit-Hartenberg joints; the base has index 0."""

_PREFIXES = ("cmeel.prefix", "")


def link_meshes(arm: Arm) -> dict[int, tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "m 3"]]]:
    """Vertices [m] and triangles of each link, by frame index.

    Frame 0 is the base, followed by the joints and the flange.
    """
    import trimesh

    found: dict[int, list[trimesh.Trimesh]] = {}
    for number in range(arm.num_joints + 1):
        path = _description(arm.name, number)
        if path is not None:
            found[number] = [trimesh.load_mesh(path)]  # type: ignore[list-item]
    if not found:
        for link in arm.links:
            ends = np.array([link.start, link.end])
            if np.ptp(ends, axis=0).any():
                shape = trimesh.creation.cylinder(link.radius, segment=ends, sections=24)
            else:
                shape = trimesh.creation.icosphere(2, link.radius)
                shape.apply_translation(ends[0])
            balls = [trimesh.creation.icosphere(2, link.radius) for _ in ends]
            for ball, end in zip(balls, ends, strict=True):
                ball.apply_translation(end)
            found.setdefault(link.frame, []).extend([shape, *balls])
    return {frame: _joined(shapes) for frame, shapes in found.items()}


def _joined(shapes: list[trimesh.Trimesh]) -> tuple[np.ndarray, np.ndarray]:
    """Merge the vertices and triangles of several shapes."""
    before = np.cumsum([0, *(len(shape.vertices) for shape in shapes)])
    faces = [shape.faces + first for shape, first in zip(shapes, before[:-1], strict=True)]
    return np.vstack([shape.vertices for shape in shapes]), np.vstack(faces)


def _description(arm: str, number: int) -> Path | None:
    """File of a link in an installed description package; None if not installed."""
    for root in sys.path:
        for prefix in _PREFIXES:
            path = Path(root) / prefix / _PACKAGE.format(arm=arm, number=number)
            if path.is_file():
                return path
    return None
