"""Scene nodes shared by the cockpit and the episode page: organ, patches, capsule, paths."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.cockpit.scene.colorings import PageMesh
from vrcaps.core.errors import import_extra
from vrcaps.core.geometry import quaternion_from_matrix

if TYPE_CHECKING:
    import viser
    from jaxtyping import Float

    from vrcaps.cockpit.scene.colorings import Color, Coloring, Patch

_FRONT_COLOR, _BODY_COLOR = (70, 150, 255), (240, 240, 245)
_PATH_STEP = 1e-3
"""Distance between points of a growing path [m]."""
_VISIBLE = 2e-4
"""Motion of the wall [m] below which it is not updated."""
_SAME_PLACE, _SAME_TURN = 1e-5, 1e-4
"""Differences in position [m] and quaternion below which a node is not moved."""
_AXES = ("x", "y", "z")
_CUT_STEP = 4e-3
"""Distance [m] in whose multiples a cut follows the capsule."""
CUTS = {
    "capsule": "at the capsule",
    "none": "none",
    "x": "across x",
    "y": "across y",
    "z": "across z",
}
"""Cuts of the organ, and their labels."""


@dataclass(frozen=True)
class Cut:
    """Clipping plane across a world axis; its lower side is removed.

    Attributes:
        kind: One of `CUTS`.
        fraction: Position from 0, the organ's lowest point along the axis, to 1.
        level: Position along y of the plane in front of the capsule [m].
    """

    kind: str = "none"
    fraction: float = 0.5
    level: float = 0.0

    def keeps(self, points: Float[np.ndarray, "n 3"], faces: np.ndarray) -> np.ndarray:
        """Mask of the triangles that are kept, by their centers."""
        if self.kind == "none":
            return np.ones(len(faces), bool)
        if self.kind == "capsule":
            return points[faces, 1].mean(axis=1) >= self.level
        along = points[:, _AXES.index(self.kind)]
        level = along.min() + self.fraction * np.ptp(along)
        return along[faces].mean(axis=1) >= level


def cut_of(
    kind: str, fraction: float, T_world_capsule: Float[np.ndarray, "4 4"], radius: float
) -> Cut:
    """Cut of the organ while the capsule is at a pose.

    Args:
        kind: One of `CUTS`.
        fraction: See `Cut`.
        T_world_capsule: Pose of the capsule.
        radius: Radius of the capsule [m].
    """
    if kind != "capsule":
        return Cut(kind, fraction)
    front = float(T_world_capsule[1, 3]) - radius
    return Cut(kind, level=_CUT_STEP * np.floor(front / _CUT_STEP))


@dataclass(frozen=True)
class _Part:
    """Triangles of one color: their fine vertices, and the mesh in the page."""

    vertices: np.ndarray
    handle: Any

    def move(self, points: np.ndarray) -> None:
        """Move it to the wall's vertices, if the difference is visible."""
        positions = points[self.vertices].astype(np.float32)
        if np.abs(positions - self.handle.vertices).max() > _VISIBLE:
            self.handle.vertices = positions


class OrganNode:
    """Organ's wall in a scene: one mesh per color, as meshes have no vertex colors."""

    def __init__(self, scene: viser.SceneApi, mesh: PageMesh) -> None:
        self._scene, self._mesh = scene, mesh
        self._parts: dict[int, _Part] = {}
        self._opacity: float | None = None

    def draw(self, points: Float[np.ndarray, "n 3"], coloring: Coloring, cut: Cut) -> None:
        """Redraw the wall.

        Args:
            points: Vertices of the fine wall in the world [m].
            coloring: Colors of its triangles.
            cut: Part to remove.
        """
        faces, classes = self._mesh.faces, coloring.classes()
        kept = cut.keeps(points[self._mesh.vertices], faces)
        before, self._parts = self._parts, {}
        for number in map(int, np.unique(classes[kept])):
            mine = faces[kept & (classes == number)]
            self._parts[number] = self._add(number, mine, points, coloring.colors[number])
        for number in before.keys() - self._parts.keys():  # a part of the same name is replaced
            before[number].handle.remove()

    def move(self, points: Float[np.ndarray, "n 3"]) -> None:
        """Move it to the fine wall's vertices [m]."""
        for part in self._parts.values():
            part.move(points)

    def set_opacity(self, opacity: float) -> None:
        """Set the opacity, from 0 to 1."""
        self._opacity = None if opacity >= 1.0 else opacity
        for part in self._parts.values():
            if part.handle.opacity != self._opacity:
                part.handle.opacity = self._opacity

    def _add(self, index: int, faces: np.ndarray, points: np.ndarray, color: Color) -> _Part:
        used, local = np.unique(faces, return_inverse=True)
        fine = self._mesh.vertices[used]
        handle = self._scene.add_mesh_simple(
            f"/organ/{index}",
            points[fine],
            local.reshape(-1, 3),
            color=color,
            opacity=self._opacity,
            side="double",
            cast_shadow=False,
            receive_shadow=False,
        )
        return _Part(fine, handle)


class PatchNode:
    """Patches in addition to the wall; redrawn if they have changed."""

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._drawn: dict[str, tuple[np.ndarray, Any]] = {}

    def draw(self, patches: tuple[Patch, ...]) -> None:
        """Draw exactly these patches."""
        wanted = {f"/patch/{number}": patch for number, patch in enumerate(patches)}
        for name in self._drawn.keys() - wanted.keys():
            self._drawn.pop(name)[1].remove()
        for name, patch in wanted.items():
            corners = patch.corners.reshape(-1, 3).astype(np.float32)
            if self._shows(name, corners, patch.color):
                continue
            handle = self._scene.add_mesh_simple(
                name,
                corners,
                np.arange(len(corners)).reshape(-1, 3),
                color=patch.color,
                side="double",
                cast_shadow=False,
                receive_shadow=False,
            )
            self._drawn[name] = (corners, handle)

    def _shows(self, name: str, corners: np.ndarray, color: Color) -> bool:
        """True if a node already shows this, up to invisible differences."""
        before, handle = self._drawn.get(name, (np.empty((0, 3)), None))
        if handle is None or handle.color != color or before.shape != corners.shape:
            return False
        return bool(np.abs(before - corners).max() < _VISIBLE)


def add_capsule(
    scene: viser.SceneApi,
    name: str,
    length: float,
    radius: float,
    color: Color = _BODY_COLOR,
) -> Any:
    """Add a capsule with a blue front, as a movable frame.

    Args:
        scene: Scene to add to.
        name: Name of the node.
        length: Length of the body [m].
        radius: Radius of the body [m].
        color: Color of the body.
    """
    trimesh = import_extra("trimesh", "cockpit")

    body = trimesh.creation.capsule(length - 2.0 * radius, radius, count=[16, 24])
    body.apply_translation([0.0, 0.0, -body.bounds.mean(axis=0)[2]])
    front = trimesh.creation.icosphere(2, 0.6 * radius)
    front.apply_translation([0.0, 0.0, 0.5 * length - 0.5 * radius])
    frame = scene.add_frame(name, show_axes=False)
    add_shape(scene, f"{name}/body", body, color)
    add_shape(scene, f"{name}/front", front, _FRONT_COLOR)
    return frame


def add_shape(scene: viser.SceneApi, name: str, shape: Any, color: Color) -> None:
    """Add a trimesh mesh in one color."""
    vertices, faces = np.asarray(shape.vertices), np.asarray(shape.faces)
    scene.add_mesh_simple(name, vertices, faces, color=color)


def add_path(
    scene: viser.SceneApi,
    name: str,
    positions: Float[np.ndarray, "n 3"],
    color: Color,
) -> None:
    """Add a line through two or more positions in the world [m]."""
    segments = np.stack([positions[:-1], positions[1:]], axis=1).astype(np.float32)
    scene.add_line_segments(name, segments, colors=color, thickness=3.0, thickness_units="screen")


class PathNode:
    """Growing path; points are added only after some motion, since all are sent each time."""

    def __init__(self, scene: viser.SceneApi, name: str, color: Color) -> None:
        self._scene, self._name, self._color = scene, name, color
        self._times: list[float] = []
        self._path: list[np.ndarray] = []
        self._num_drawn = 0

    @property
    def positions(self) -> Float[np.ndarray, "n 3"]:
        """Points in the world [m]."""
        return np.array(self._path).reshape(-1, 3)

    def add(self, time: float, position: Float[np.ndarray, " 3"]) -> None:
        """Add a position [m] at a time [s], 0 or later; remove those at later times."""
        while self._times and self._times[-1] > time:
            self._times.pop()
            self._path.pop()
            self._num_drawn = 0
        if time < 0.0:
            return
        if not self._path or np.linalg.norm(position - self._path[-1]) >= _PATH_STEP:
            self._times.append(time)
            self._path.append(position)

    def draw(self) -> None:
        """Draw it, if it has changed."""
        if len(self._path) >= 2 and len(self._path) != self._num_drawn:
            self._num_drawn = len(self._path)
            add_path(self._scene, self._name, self.positions, self._color)


def move(handle: Any, T: Float[np.ndarray, "4 4"]) -> None:
    """Set a node's pose, if the difference is visible."""
    wxyz = quaternion_from_matrix(T[:3, :3])
    if np.abs(handle.position - T[:3, 3]).max() > _SAME_PLACE:
        handle.position = T[:3, 3]
    if np.abs(handle.wxyz - wxyz).max() > _SAME_TURN:
        handle.wxyz = wxyz
