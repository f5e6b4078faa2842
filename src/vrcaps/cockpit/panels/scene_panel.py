"""Scene panel: organ, capsule, magnet and arm in three dimensions."""

from __future__ import annotations

import time as wall_clock
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.actuation.arm.kinematics import frames
from vrcaps.actuation.robot_actuator import RobotActuator
from vrcaps.cockpit.arm_shapes import link_meshes
from vrcaps.cockpit.organ_colors import COLORINGS, Coloring
from vrcaps.cockpit.page_mesh import coarse_mesh
from vrcaps.cockpit.scene_nodes import OrganNode, add_capsule, add_path, add_shape, aim, move
from vrcaps.magnet.presets import read_magnet
from vrcaps.magnet.sources import Cylinder
from vrcaps.units import CM

if TYPE_CHECKING:
    from vrcaps.cockpit.page import Page
    from vrcaps.cockpit.view import View

_SECONDS_PER_WALL = 0.5
"""Real time between updates of the wall and its colors."""
_MAGNET_COLOR, _NORTH_COLOR = (70, 72, 80), (210, 60, 50)
_ARM_COLOR, _PATH_COLOR = (225, 228, 232), (255, 190, 40)
_MAGNET_SIZE = (5.0 * CM, 5.0 * CM)
"""Diameter and length at which a point dipole is drawn."""
_BELOW = 3.0 * CM
"""Gap between organ and table."""


class ScenePanel:
    """The scene, and how it is drawn."""

    def __init__(self, page: Page) -> None:
        program = page.session.rollout.program
        assert program is not None
        self._page, self._session, self._program = page, page.session, program
        self._model, self._scene = page.session.model, page.server.scene
        organ = self._model.organ
        self._mesh = coarse_mesh(self._model.vertices_world, organ.faces)
        self._organ = OrganNode(self._scene, self._mesh)
        self._coloring: Coloring | None = None
        self._drawn: tuple[object, ...] = ()
        self._wall_time, self._path_length = 0.0, 0
        gui = page.server.gui
        with gui.add_folder("Scene", expand_by_default=False):
            names = tuple(name for name, kind in COLORINGS.items() if kind.fits(organ))
            self._color = gui.add_dropdown("Color by", names)
            self._opacity = gui.add_slider("Opacity", 0.1, 1.0, 0.05, 0.35)
            self._is_cut = gui.add_checkbox("Cut open", False)
            self._legend = gui.add_markdown("")
        points, magnet = self._model.vertices_world, program.controller.requested[:3, 3]
        low, high = points.min(axis=0), np.maximum(points.max(axis=0), magnet)
        aim(page.server, low, high, low[2] - _BELOW)
        device = self._model.device
        self._capsule = add_capsule(self._scene, "/capsule", device.length, device.radius)
        self._magnet = self._add_magnet()
        self._arm_frames = self._add_arm()

    def update(self, view: View) -> None:
        """Moves everything to where it is."""
        move(self._capsule, view.state.T_world_capsule)
        move(self._magnet, view.T_world_magnet)
        actuator = self._program.controller.actuator
        if isinstance(actuator, RobotActuator) and self._arm_frames:
            placed = frames(actuator.robot.arm, view.joint_angles)
            poses = actuator.robot.T_world_base @ np.concatenate([np.eye(4)[None], placed])
            for number, handle in self._arm_frames.items():
                move(handle, poses[number])
        now = wall_clock.monotonic()
        if now - self._wall_time > _SECONDS_PER_WALL:
            self._wall_time = now
            self._draw_wall(view)
            self._draw_path()

    def _draw_wall(self, view: View) -> None:
        """Draws the wall anew where its colors have changed; else moves it."""
        moved = view.state.vertices_world
        points = self._model.vertices_world if moved is None else moved
        if self._coloring is None or self._coloring.name != self._color.value:
            kind = COLORINGS[self._color.value]
            self._coloring = kind(self._model.organ, self._mesh, self._page.seen)
        wanted = (self._color.value, self._is_cut.value, self._coloring.version)
        self._organ.set_opacity(self._opacity.value)
        if wanted != self._drawn:
            self._drawn = wanted
            self._organ.draw(points, self._coloring, is_cut=self._is_cut.value)
            self._legend.content = self._coloring.legend()
        elif moved is not None:
            self._organ.move(points)

    def _draw_path(self) -> None:
        """Draws the capsule's path so far."""
        places = self._session.poses[:, :3, 3]
        if len(places) != self._path_length and len(places) >= 2:
            self._path_length = len(places)
            add_path(self._scene, "/path", places, _PATH_COLOR)

    def _add_magnet(self) -> Any:
        import trimesh

        magnet = read_magnet(self._program.settings.magnet)
        diameter, length = _MAGNET_SIZE
        if isinstance(magnet, Cylinder):
            diameter, length = magnet.diameter, magnet.length
        frame = self._scene.add_frame("/magnet", show_axes=False)
        for name, color, side in (("south", _MAGNET_COLOR, -1.0), ("north", _NORTH_COLOR, 1.0)):
            half = trimesh.creation.cylinder(0.5 * diameter, 0.5 * length, sections=32)
            half.apply_translation([0.0, 0.0, 0.25 * side * length])
            add_shape(self._scene, f"/magnet/{name}", half, color)
        return frame

    def _add_arm(self) -> dict[int, Any]:
        """Nodes of the arm's links by their frame; empty without an arm."""
        actuator = self._program.controller.actuator
        if not isinstance(actuator, RobotActuator):
            return {}
        placed = {}
        for number, (vertices, faces) in link_meshes(actuator.robot.arm).items():
            placed[number] = self._scene.add_frame(f"/arm/{number}", show_axes=False)
            name = f"/arm/{number}/link"
            self._scene.add_mesh_simple(name, vertices, faces, color=_ARM_COLOR)
        return placed
