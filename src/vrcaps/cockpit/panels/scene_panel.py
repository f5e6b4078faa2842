"""Scene panel: organ, capsule, magnet and arm in three dimensions."""

from __future__ import annotations

import time as wall_clock
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.actuation.arm.kinematics import frames
from vrcaps.actuation.robot_actuator import RobotActuator
from vrcaps.cockpit.arm_shapes import link_meshes
from vrcaps.cockpit.organ_colors import COLORINGS, Coloring
from vrcaps.cockpit.page_mesh import coarse_mesh
from vrcaps.magnet.presets import read_magnet
from vrcaps.magnet.sources import Cylinder
from vrcaps.transforms import quaternion_from_matrix

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.cockpit.page import Page
    from vrcaps.cockpit.view import View

_SECONDS_PER_WALL = 0.5
"""Real time between updates of the wall and its colors."""
_CAPSULE_COLOR, _FRONT_COLOR = (240, 240, 245), (70, 150, 255)
_MAGNET_COLOR, _NORTH_COLOR = (70, 72, 80), (210, 60, 50)
_ARM_COLOR, _TABLE_COLOR = (225, 228, 232), (120, 132, 145)
_TRACK_COLOR = (255, 190, 40)
_MAGNET_SIZE = (0.05, 0.05)
"""Diameter and length [m] at which a point dipole is drawn."""


@dataclass(frozen=True)
class _Part:
    """Triangles of one color: their fine vertices, and the mesh in the page."""

    vertices: np.ndarray
    handle: Any


class ScenePanel:
    """The scene, and how it is drawn."""

    def __init__(self, page: Page) -> None:
        self._page, self._session = page, page.session
        self._model = page.session.model
        self._scene = page.server.scene
        organ = self._model.organ
        self._mesh = coarse_mesh(self._model.vertices_world, organ.faces)
        self._coloring: Coloring | None = None
        self._parts: list[_Part] = []
        self._drawn: tuple[object, ...] = ()
        self._wall_time, self._track_length = 0.0, 0
        gui = page.server.gui
        with gui.add_folder("Scene", expand_by_default=False):
            names = tuple(name for name, kind in COLORINGS.items() if kind.fits(organ))
            self._color = gui.add_dropdown("Color by", names)
            self._opacity = gui.add_slider("Opacity", 0.1, 1.0, 0.05, 0.35)
            self._is_cut = gui.add_checkbox("Cut open", False)
            self._legend = gui.add_markdown("")
        self._set_camera()
        self._add_capsule()
        self._add_magnet()
        self._arm_frames = self._add_arm()

    def update(self, view: View) -> None:
        """Moves everything to where it is."""
        self._capsule.wxyz, self._capsule.position = _pose(view.state.T_world_capsule)
        self._magnet.wxyz, self._magnet.position = _pose(view.T_world_magnet)
        actuator = self._session.rollout.program.controller.actuator  # type: ignore[union-attr]
        if isinstance(actuator, RobotActuator) and self._arm_frames:
            base = actuator.robot.T_world_base
            placed = frames(actuator.robot.arm, view.joint_angles)
            poses = base @ np.concatenate([np.eye(4)[None], placed])
            for number, handle in self._arm_frames.items():
                handle.wxyz, handle.position = _pose(poses[number])
        now = wall_clock.monotonic()
        if now - self._wall_time > _SECONDS_PER_WALL:
            self._wall_time = now
            self._draw_wall(view)
            self._draw_track()

    def _draw_wall(self, view: View) -> None:
        """Draws the wall anew where its colors have changed; else moves it."""
        points = view.state.vertices_world
        points = self._model.vertices_world if points is None else points
        if self._coloring is None or self._coloring.name != self._color.value:
            kind = COLORINGS[self._color.value]
            self._coloring = kind(self._model, self._mesh, self._page.seen)
        wanted = (self._color.value, self._is_cut.value, self._coloring.version)
        if wanted != self._drawn:
            self._drawn = wanted
            self._draw_parts(points)
        elif view.state.vertices_world is not None:
            for part in self._parts:
                part.handle.vertices = points[part.vertices].astype(np.float32)
        opacity = None if self._opacity.value >= 1.0 else self._opacity.value
        for part in self._parts:
            if part.handle.opacity != opacity:
                part.handle.opacity = opacity

    def _draw_parts(self, points: Float[np.ndarray, "n 3"]) -> None:
        """One mesh for each color: a mesh of the page has no colors of its own."""
        assert self._coloring is not None
        faces, classes = self._mesh.faces, self._coloring.classes()
        kept = np.ones(len(faces), bool)
        if self._is_cut.value:
            middle = points[self._mesh.vertices].mean(axis=0)
            kept = points[self._mesh.vertices][faces][:, :, 1].mean(axis=1) > middle[1]
        for part in self._parts:
            part.handle.remove()
        self._parts = []
        for number in np.unique(classes):
            mine = faces[kept & (classes == number)]
            if not len(mine):
                continue
            used, local = np.unique(mine, return_inverse=True)
            fine = self._mesh.vertices[used]
            handle = self._scene.add_mesh_simple(
                f"/organ/{number}",
                points[fine],
                local.reshape(-1, 3),
                color=self._coloring.colors[number],
                opacity=self._opacity.value,
                side="double",
                cast_shadow=False,
                receive_shadow=False,
            )
            self._parts.append(_Part(fine, handle))
        self._legend.content = self._coloring.legend()

    def _draw_track(self) -> None:
        """Draws the capsule's path so far."""
        places = self._session.poses[:, :3, 3]
        if len(places) == self._track_length or len(places) < 2:
            return
        self._track_length = len(places)
        segments = np.stack([places[:-1], places[1:]], axis=1)
        self._scene.add_line_segments(
            "/track",
            segments.astype(np.float32),
            colors=_TRACK_COLOR,
            thickness=3.0,
            thickness_units="screen",
        )

    def _set_camera(self) -> None:
        low, high = self._model.vertices_world.min(axis=0), self._model.vertices_world.max(axis=0)
        middle, size = 0.5 * (low + high), float(np.linalg.norm(high - low))
        camera = self._page.server.initial_camera
        top = max(high[2], self._session.rollout.program.controller.requested[2, 3])  # type: ignore[union-attr]
        middle[2], size = 0.5 * (low[2] + top), max(size, 1.5 * (top - low[2]))
        camera.position = tuple(middle + size * np.array([0.25, -1.25, 0.45]))
        camera.look_at = tuple(middle)
        self._scene.configure_default_lights(enabled=True, cast_shadow=False)
        self._scene.add_grid(
            "/table",
            width=1.2,
            height=0.6,
            cell_size=0.05,
            section_size=0.1,
            cell_color=_TABLE_COLOR,
            section_color=_TABLE_COLOR,
            position=(middle[0], middle[1], low[2] - 0.03),
        )

    def _add_capsule(self) -> None:
        import trimesh

        device = self._model.device
        height = device.length - 2.0 * device.radius
        shape = trimesh.creation.capsule(height, device.radius, count=[16, 24])
        shape.apply_translation([0.0, 0.0, -shape.bounds.mean(axis=0)[2]])
        self._capsule = self._scene.add_frame("/capsule", show_axes=False)
        self._add("/capsule/body", shape, _CAPSULE_COLOR)
        front = trimesh.creation.icosphere(2, 0.6 * device.radius)
        front.apply_translation([0.0, 0.0, 0.5 * device.length - 0.5 * device.radius])
        self._add("/capsule/front", front, _FRONT_COLOR)

    def _add_magnet(self) -> None:
        import trimesh

        settings = self._session.rollout.program.settings  # type: ignore[union-attr]
        magnet = read_magnet(settings.magnet)
        diameter, length = _MAGNET_SIZE
        if isinstance(magnet, Cylinder):
            diameter, length = magnet.diameter, magnet.length
        self._magnet = self._scene.add_frame("/magnet", show_axes=False)
        for name, color, side in (("south", _MAGNET_COLOR, -1.0), ("north", _NORTH_COLOR, 1.0)):
            half = trimesh.creation.cylinder(0.5 * diameter, 0.5 * length, sections=32)
            half.apply_translation([0.0, 0.0, 0.25 * side * length])
            self._add(f"/magnet/{name}", half, color)

    def _add_arm(self) -> dict[int, Any]:
        actuator = self._session.rollout.program.controller.actuator  # type: ignore[union-attr]
        if not isinstance(actuator, RobotActuator):
            return {}
        placed = {}
        for number, (vertices, faces) in link_meshes(actuator.robot.arm).items():
            placed[number] = self._scene.add_frame(f"/arm/{number}", show_axes=False)
            name = f"/arm/{number}/link"
            self._scene.add_mesh_simple(name, vertices, faces, color=_ARM_COLOR)
        return placed

    def _add(self, name: str, shape: Any, color: tuple[int, int, int]) -> None:
        vertices, faces = np.asarray(shape.vertices), np.asarray(shape.faces)
        self._scene.add_mesh_simple(name, vertices, faces, color=color)


def _pose(T: Float[np.ndarray, "4 4"]) -> tuple[np.ndarray, np.ndarray]:
    """Quaternion wxyz and position of a pose."""
    return quaternion_from_matrix(T[:3, :3]), T[:3, 3]
