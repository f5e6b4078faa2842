"""Scene node of the magnet and its field lines, and meshes of the links of a robot arm."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.cockpit.scene.nodes import add_shape, move
from vrcaps.core.units import MM
from vrcaps.magnet.field import field
from vrcaps.magnet.field_lines import magnet_lines
from vrcaps.magnet.sources import Cylinder

if TYPE_CHECKING:
    import trimesh
    import viser
    from jaxtyping import Float, Int

    from vrcaps.actuation.arm.arm import Arm

_SOUTH_COLOR, _NORTH_COLOR = (70, 72, 80), (210, 60, 50)
_STRONG, _WEAK = (60, 130, 210), (18, 26, 42)
"""Colors of a line where the field is at the upper and at the lower end of `_FIELDS`."""
_FIELDS = (1e-3, 0.1)
"""Flux densities [T] between which a line fades, on a logarithmic scale."""
_REACH = 0.45
"""Distance from the magnet at which lines end [m]."""
_STEP = 4.0 * MM
_EVERY = 3
"""Stride of the points drawn of a line."""


class MagnetNode:
    """Magnet with field lines that move with it and are therefore computed only once."""

    def __init__(self, scene: viser.SceneApi, magnet: Cylinder) -> None:
        import trimesh

        self._frame = scene.add_frame("/magnet", show_axes=False)
        for name, color, side in (("south", _SOUTH_COLOR, -1.0), ("north", _NORTH_COLOR, 1.0)):
            half = trimesh.creation.cylinder(
                0.5 * magnet.diameter, 0.5 * magnet.length, sections=32
            )
            half.apply_translation([0.0, 0.0, 0.25 * side * magnet.length])
            add_shape(scene, f"/magnet/{name}", half, color)
        segments, colors = colored_lines(magnet)
        self._lines = scene.add_line_segments(
            "/magnet/field",
            segments.astype(np.float32),
            colors=colors,
            thickness=1.0,
            thickness_units="screen",
        )

    def show(self, T_world_magnet: Float[np.ndarray, "4 4"], *, has_lines: bool) -> None:
        """Set the pose and the visibility of the lines."""
        move(self._frame, T_world_magnet)
        if self._lines.visible != has_lines:
            self._lines.visible = has_lines


def colored_lines(
    magnet: Cylinder,
) -> tuple[Float[np.ndarray, "k 2 3"], Float[np.ndarray, "k 2 3"]]:
    """Segments of field lines in the magnet's frame [m], and the sRGB color of each end."""
    own = Cylinder(magnet.diameter, magnet.length, magnet.remanence)
    lines = magnet_lines(magnet, reach=_REACH, step=_STEP, rings=4, meridians=6)
    thinned = [np.concatenate([line[:-1:_EVERY], line[-1:]]) for line in lines]
    segments = np.concatenate([np.stack([line[:-1], line[1:]], axis=1) for line in thinned])
    flux = np.linalg.norm(field([own], segments.reshape(-1, 3))[0], axis=1)
    low, high = np.log(_FIELDS)
    share = np.clip((np.log(flux) - low) / (high - low), 0.0, 1.0)[:, None]
    colors = share * np.array(_STRONG) + (1.0 - share) * np.array(_WEAK)
    return segments, colors.round().astype(np.uint8).reshape(-1, 2, 3)


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
