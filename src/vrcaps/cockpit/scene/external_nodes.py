"""Scene nodes outside the organ: magnet with field lines, coils, links of an arm, and the patient.

The patient is a schematic outline of a lying adult, on a table. It shows head, feet, left and
posture. It is not anatomically exact: the sections are rounded values of an adult of 1.75 m, and
the organ may come from another patient.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.actuation.coil_array import MappedCoil
from vrcaps.cockpit.scene.nodes import move
from vrcaps.core.errors import import_extra
from vrcaps.core.geometry import transform_from, transform_points
from vrcaps.core.units import CM, MM
from vrcaps.magnet.field import field, magnet_lines
from vrcaps.magnet.magnets import magnet_mesh
from vrcaps.magnet.sources import Magnet

if TYPE_CHECKING:
    import trimesh
    import viser
    from jaxtyping import Float, Int

    from vrcaps.actuation.arm.arm import Arm
    from vrcaps.actuation.coil_array import Electromagnet
    from vrcaps.actuation.coil_program import CoilProgram

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
    """Magnet with field lines that move with it and are therefore computed only once.

    Attributes:
        radius: Maximum distance of its surface from its center [m].
    """

    def __init__(self, scene: viser.SceneApi, magnet: Magnet) -> None:
        trimesh = import_extra("trimesh", "cockpit")

        self._frame = scene.add_frame("/magnet", show_axes=False)
        mesh = magnet_mesh(magnet)
        self.radius = float(np.linalg.norm(mesh.vertices, axis=1).max())
        for name, color, side in (("south", _SOUTH_COLOR, -1.0), ("north", _NORTH_COLOR, 1.0)):
            vertices, faces, _ = trimesh.intersections.slice_faces_plane(
                mesh.vertices, mesh.faces, (0.0, 0.0, side), (0.0, 0.0, 0.0)
            )
            scene.add_mesh_simple(f"/magnet/{name}", vertices, faces, color=color)
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
    magnet: Magnet,
) -> tuple[Float[np.ndarray, "k 2 3"], Float[np.ndarray, "k 2 3"]]:
    """Segments of field lines in the magnet's frame [m], and the sRGB color of each end."""
    own = replace(magnet, T_world_magnet=np.eye(4))
    lines = magnet_lines(magnet, reach=_REACH, step=_STEP, rings=4, meridians=6)
    thinned = [np.concatenate([line[:-1:_EVERY], line[-1:]]) for line in lines]
    segments = np.concatenate([np.stack([line[:-1], line[1:]], axis=1) for line in thinned])
    flux = np.linalg.norm(field([own], segments.reshape(-1, 3))[0], axis=1)
    low, high = np.log(_FIELDS)
    share = np.clip((np.log(flux) - low) / (high - low), 0.0, 1.0)[:, None]
    colors = share * np.array(_STRONG) + (1.0 - share) * np.array(_WEAK)
    return segments, colors.round().astype(np.uint8).reshape(-1, 2, 3)


_COIL_OFF, _COIL_NORTH, _COIL_SOUTH = (128, 116, 100), (210, 60, 50), (60, 130, 210)
"""Colors of a coil without current, and of one at its maximum in either direction."""
_MAPPED_RADIUS, _MAPPED_LENGTH = 2.0 * CM, 4.0 * CM
"""Size at which a coil is drawn that has a field map but no shape [m]."""


class CoilNodes:
    """Coils of an array, colored by their currents: red where the upper end is a north pole.

    Attributes:
        box: Corners of the box around them in the world [m].
    """

    def __init__(self, scene: viser.SceneApi, program: CoilProgram) -> None:
        self._most = program.array.values("max_current")
        self._handles, self._shown = [], np.full((len(self._most), 3), -1)
        corners = []
        for number, coil in enumerate(program.array.coils, 1):
            vertices, faces = coil_mesh(coil)
            pose = coil.pose(program.T_world_array)
            handle = scene.add_mesh_simple(f"/coils/{number}", vertices, faces, color=_COIL_OFF)
            move(handle, pose)
            self._handles.append(handle)
            corners.append(transform_points(pose, vertices))
        points = np.concatenate(corners)
        self.box = points.min(axis=0), points.max(axis=0)

    def show(self, currents: Float[np.ndarray, " k"]) -> None:
        """Set the colors by the currents [A]."""
        share = np.clip(currents / self._most, -1.0, 1.0)[:, None]
        full = np.where(share > 0.0, _COIL_NORTH, _COIL_SOUTH)
        colors = np.rint((1.0 - np.abs(share)) * _COIL_OFF + np.abs(share) * full).astype(int)
        for k in np.flatnonzero((colors != self._shown).any(axis=1)).tolist():
            self._handles[k].color = tuple(colors[k].tolist())
        self._shown = colors


def coil_mesh(
    coil: Electromagnet | MappedCoil,
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "m 3"]]:
    """Vertices [m] and triangles of a coil in its frame, z along its moment."""
    trimesh = import_extra("trimesh", "cockpit")

    if isinstance(coil, MappedCoil):
        mesh = trimesh.creation.cylinder(_MAPPED_RADIUS, _MAPPED_LENGTH, sections=32)
    else:
        half = max(0.5 * coil.thickness, 0.05 * coil.radius)
        inner = max(coil.radius - half, 0.05 * coil.radius)
        mesh = trimesh.creation.annulus(inner, coil.radius + half, coil.length, sections=32)
    return np.array(mesh.vertices), np.array(mesh.faces)


_PACKAGE = "share/example-robot-data/robots/{arm}_description/meshes/collision/link{number}.stl"
"""Path of an arm's links in the package example-robot-data. The frames of the Panda's links are
those of its Denavit-Hartenberg joints; the base has index 0."""

_PREFIXES = ("cmeel.prefix", "")


def link_meshes(arm: Arm) -> dict[int, tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "m 3"]]]:
    """Vertices [m] and triangles of each link, by frame index.

    Frame 0 is the base, followed by the joints and the flange.
    """
    trimesh = import_extra("trimesh", "cockpit")

    meshes: dict[int, list[trimesh.Trimesh]] = {}
    for number in range(arm.num_joints + 1):
        path = _description(arm.name, number)
        if path is not None:
            meshes[number] = [trimesh.load_mesh(path)]  # type: ignore[list-item]
    if not meshes:
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
            meshes.setdefault(link.frame, []).extend([shape, *balls])
    return {frame: _joined(shapes) for frame, shapes in meshes.items()}


def _joined(shapes: list[trimesh.Trimesh]) -> tuple[np.ndarray, np.ndarray]:
    """Merge the vertices and triangles of several shapes."""
    before = np.cumsum([0, *(len(shape.vertices) for shape in shapes)])
    faces = [shape.faces + first for shape, first in zip(shapes, before[:-1], strict=True)]
    return np.vstack([shape.vertices for shape in shapes]), np.vstack(faces)


def _description(arm: str, link: int) -> Path | None:
    """File of a link in an installed description package; None if not installed."""
    for root in sys.path:
        for prefix in _PREFIXES:
            path = Path(root) / prefix / _PACKAGE.format(arm=arm, number=link)
            if path.is_file():
                return path
    return None


_AROUND = 24
"""Number of corners of a section."""
_ALONG = 6
"""Stride of the corners connected by lines from section to section."""
_MARGIN = 2.0 * CM
"""Gap between the organ and the outline."""

# Sections [cm]: height above the navel, offset to the left and backwards from the middle; half the
# width and depth.
_TRUNK = (
    *((-24.0, 0.0, 0.0, 17.0, 11.0), (-12.0, 0.0, 0.0, 17.5, 12.0), (0.0, 0.0, 0.0, 16.0, 12.0)),
    *((12.0, 0.0, 0.0, 15.5, 12.0), (24.0, 0.0, 0.0, 16.0, 12.5), (34.0, 0.0, 0.5, 18.0, 11.5)),
    *((40.0, 0.0, 1.0, 16.0, 8.5), (43.0, 0.0, 1.0, 7.0, 6.5), (49.0, 0.0, 0.5, 6.0, 6.5)),
)
_HEAD = (
    *((49.0, 0.0, 0.0, 5.5, 7.5), (54.0, 0.0, -0.5, 7.0, 9.5), (60.0, 0.0, 0.0, 7.5, 10.0)),
    *((66.0, 0.0, 0.5, 6.5, 8.5), (70.0, 0.0, 0.5, 2.0, 3.0)),
)
_LEG = (
    *((-24.0, 9.0, 0.5, 8.5, 9.5), (-40.0, 9.5, 0.5, 7.5, 8.0), (-56.0, 9.5, 0.5, 5.5, 6.0)),
    *((-68.0, 10.0, 2.0, 5.5, 6.0), (-96.0, 10.0, 2.5, 3.5, 4.0), (-103.0, 10.0, -3.0, 4.5, 10.0)),
)
_ARM = (
    *((37.0, 20.0, 1.0, 4.5, 5.5), (10.0, 24.0, 2.0, 4.5, 5.0), (-12.0, 26.0, 2.0, 3.0, 3.5)),
    *((-30.0, 27.0, 1.5, 2.0, 4.5),),
)
_MIRROR = np.array([1.0, -1.0, 1.0, 1.0, 1.0])
_PARTS = (
    *(np.array(_TRUNK), np.array(_HEAD), np.array(_LEG), np.array(_LEG) * _MIRROR),
    *(np.array(_ARM), np.array(_ARM) * _MIRROR),
)
_TRUNK_AT_ORGAN = slice(0, 6)
"""Sections of the trunk that may enclose an organ."""


def patient_outline(organ: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "k 2 3"]:
    """Lines of a patient's outline around an organ, in the patient frame [m].

    Generated organs have their origin at the height of the navel. If an organ does not fit there,
    such as one in a scanner's frame, the outline is first moved, then widened.

    Args:
        organ: Vertices of its wall in the patient frame [m].
    """
    low, high = organ.min(axis=0) - _MARGIN, organ.max(axis=0) + _MARGIN
    trunk = CM * np.array(_TRUNK)[_TRUNK_AT_ORGAN]
    center = np.zeros(3)
    room = np.array([trunk[:, 3].max(), trunk[:, 4].max()])
    fits = (np.abs([low[:2], high[:2]]) <= room).all() and trunk[0, 0] <= low[2] <= trunk[-1, 0]
    if not fits:
        center = 0.5 * (low + high)
    farthest = np.abs([low - center, high - center]).max(axis=0)[:2]
    wider = np.maximum(1.0, farthest / room)
    lines = [_lines(CM * sections) for sections in _PARTS]
    return np.concatenate(lines) * (*wider, 1.0) + center


def _lines(sections: Float[np.ndarray, "s 5"]) -> Float[np.ndarray, "k 2 3"]:
    """Ellipses around each section of a part, and lines along it from section to section [m]."""
    height, left, back, breadth, depth = sections.T[..., None]
    angle = 2.0 * np.pi * np.arange(_AROUND) / _AROUND
    x, y = left + breadth * np.cos(angle), back + depth * np.sin(angle)
    rings = np.stack([x, y, np.broadcast_to(height, x.shape)], axis=-1)
    around = np.stack([rings, np.roll(rings, -1, axis=1)], axis=2)
    chosen = rings[:, ::_ALONG]
    along = np.stack([chosen[:-1], chosen[1:]], axis=2)
    return np.concatenate([around.reshape(-1, 2, 3), along.reshape(-1, 2, 3)])


_OUTLINE_COLOR, _TABLE_COLOR = (104, 92, 86), (20, 23, 27)
_TABLE_SIZE = (0.6, 1.95, 0.05)
"""Width, length and thickness [m]."""
_LYING = 0.5
"""Maximum |vertical component| of the feet-to-head direction of a patient who lies on a table."""


class PatientNode:
    """Schematic outline around the organ, and a table below unless the patient stands."""

    def __init__(self, scene: viser.SceneApi, organ: Float[np.ndarray, "n 3"]) -> None:
        """Add both to a scene.

        Args:
            scene: Scene to add to.
            organ: Vertices of its wall in the patient frame [m].
        """
        lines = patient_outline(organ)
        self._points = lines.reshape(-1, 3)
        self._frame = scene.add_frame("/patient", show_axes=False)
        scene.add_line_segments(
            "/patient/outline",
            lines.astype(np.float32),
            colors=_OUTLINE_COLOR,
            thickness=1.0,
            thickness_units="screen",
        )
        self._table = scene.add_box("/table", color=_TABLE_COLOR, dimensions=_TABLE_SIZE)
        self._shown: np.ndarray | None = None
        self._is_visible = True

    def show(self, T_world_patient: Float[np.ndarray, "4 4"], *, is_visible: bool) -> None:
        """Move both to the patient's posture, if it has changed."""
        same = self._shown is not None and np.array_equal(T_world_patient, self._shown)
        if same and is_visible == self._is_visible:
            return
        self._shown, self._is_visible = T_world_patient.copy(), is_visible
        self._frame.visible = is_visible
        move(self._frame, T_world_patient)
        to_head = T_world_patient[:3, 2]
        self._table.visible = is_visible and abs(to_head[2]) < _LYING
        if self._table.visible:
            move(self._table, self._table_pose(T_world_patient))

    def _table_pose(self, T_world_patient: np.ndarray) -> np.ndarray:
        """Pose of the table's center: its length along the patient, its top at the lowest point."""
        points = transform_points(T_world_patient, self._points)
        along = T_world_patient[:3, 2] * (1.0, 1.0, 0.0)
        along /= np.linalg.norm(along)
        up = np.array([0.0, 0.0, 1.0])
        middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
        middle[2] = points[:, 2].min() - 0.5 * _TABLE_SIZE[2]
        return transform_from(np.stack([np.cross(along, up), along, up], axis=1), middle)
