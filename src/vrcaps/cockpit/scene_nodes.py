"""Scene nodes that the cockpit and the episode's page share: organ, capsule, paths, the view."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.cockpit.page_mesh import PageMesh
from vrcaps.transforms import quaternion_from_matrix

if TYPE_CHECKING:
    import viser
    from jaxtyping import Float

    from vrcaps.cockpit.organ_colors import Coloring

_FRONT_COLOR, _BODY_COLOR = (70, 150, 255), (240, 240, 245)
_TABLE_COLOR = (120, 132, 145)
_TABLE_SIZE = (1.2, 0.6)
_FROM = (0.2, -1.05, 0.4)
"""Where one looks from at first, in sizes of what is seen."""


@dataclass(frozen=True)
class _Part:
    """Triangles of one color: their fine vertices, and the mesh in the page."""

    vertices: np.ndarray
    handle: Any


class OrganNode:
    """The organ's wall in a scene: one mesh for each color, as a mesh has no colors of its own."""

    def __init__(self, scene: viser.SceneApi, mesh: PageMesh) -> None:
        self._scene, self._mesh = scene, mesh
        self._parts: list[_Part] = []
        self._opacity: float | None = None

    def draw(self, points: Float[np.ndarray, "n 3"], coloring: Coloring, *, is_cut: bool) -> None:
        """Draws it anew.

        Args:
            points: Vertices of the fine wall in the world [m].
            coloring: Colors of its triangles.
            is_cut: Leave out the half towards −y.
        """
        faces, classes = self._mesh.faces, coloring.classes()
        kept = np.ones(len(faces), bool)
        if is_cut:
            coarse = points[self._mesh.vertices]
            kept = coarse[faces][:, :, 1].mean(axis=1) > coarse[:, 1].mean()
        for part in self._parts:
            part.handle.remove()
        groups = [(number, faces[kept & (classes == number)]) for number in np.unique(classes)]
        self._parts = [
            self._add(number, mine, points, coloring.colors[number])
            for number, mine in groups
            if len(mine)
        ]

    def move(self, points: Float[np.ndarray, "n 3"]) -> None:
        """Moves it to where the fine wall's vertices are [m]."""
        for part in self._parts:
            part.handle.vertices = points[part.vertices].astype(np.float32)

    def set_opacity(self, opacity: float) -> None:
        """Makes it as opaque, from 0 to 1."""
        self._opacity = None if opacity >= 1.0 else opacity
        for part in self._parts:
            if part.handle.opacity != self._opacity:
                part.handle.opacity = self._opacity

    def _add(
        self, number: int, faces: np.ndarray, points: np.ndarray, color: tuple[int, int, int]
    ) -> _Part:
        used, local = np.unique(faces, return_inverse=True)
        fine = self._mesh.vertices[used]
        handle = self._scene.add_mesh_simple(
            f"/organ/{number}",
            points[fine],
            local.reshape(-1, 3),
            color=color,
            opacity=self._opacity,
            side="double",
            cast_shadow=False,
            receive_shadow=False,
        )
        return _Part(fine, handle)


def add_capsule(
    scene: viser.SceneApi,
    name: str,
    length: float,
    radius: float,
    color: tuple[int, int, int] = _BODY_COLOR,
) -> Any:
    """A capsule with a blue front, as a frame to be moved.

    Args:
        scene: Where.
        name: Of the node.
        length: Of its body [m].
        radius: Of its body [m].
        color: Of its body.
    """
    import trimesh

    body = trimesh.creation.capsule(length - 2.0 * radius, radius, count=[16, 24])
    body.apply_translation([0.0, 0.0, -body.bounds.mean(axis=0)[2]])
    front = trimesh.creation.icosphere(2, 0.6 * radius)
    front.apply_translation([0.0, 0.0, 0.5 * length - 0.5 * radius])
    frame = scene.add_frame(name, show_axes=False)
    add_shape(scene, f"{name}/body", body, color)
    add_shape(scene, f"{name}/front", front, _FRONT_COLOR)
    return frame


def add_shape(scene: viser.SceneApi, name: str, shape: Any, color: tuple[int, int, int]) -> None:
    """A mesh of trimesh in one color."""
    vertices, faces = np.asarray(shape.vertices), np.asarray(shape.faces)
    scene.add_mesh_simple(name, vertices, faces, color=color)


def add_path(
    scene: viser.SceneApi,
    name: str,
    places: Float[np.ndarray, "n 3"],
    color: tuple[int, int, int],
) -> None:
    """A line through places in the world [m], two or more."""
    segments = np.stack([places[:-1], places[1:]], axis=1).astype(np.float32)
    scene.add_line_segments(name, segments, colors=color, thickness=3.0, thickness_units="screen")


def aim(server: viser.ViserServer, low: np.ndarray, high: np.ndarray, table: float) -> None:
    """Looks at a box, with a table below it.

    Args:
        server: Of the page.
        low: Lower corner of the box in the world [m].
        high: Upper corner [m].
        table: Height of the table [m].
    """
    middle, size = 0.5 * (low + high), float(np.linalg.norm(high - low))
    camera = server.initial_camera
    camera.position = tuple(middle + size * np.array(_FROM))
    camera.look_at = tuple(middle)
    server.scene.configure_default_lights(enabled=True, cast_shadow=False)
    server.scene.add_grid(
        "/table",
        width=_TABLE_SIZE[0],
        height=_TABLE_SIZE[1],
        cell_size=0.05,
        section_size=0.1,
        cell_color=_TABLE_COLOR,
        section_color=_TABLE_COLOR,
        position=(middle[0], middle[1], table),
    )


def move(handle: Any, T: Float[np.ndarray, "4 4"]) -> None:
    """Puts a node to a pose."""
    handle.wxyz, handle.position = quaternion_from_matrix(T[:3, :3]), T[:3, 3]
