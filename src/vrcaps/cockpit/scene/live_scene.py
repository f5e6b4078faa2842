"""3D scene of a drive: organ, capsule, magnet with its gizmo, or coils, arm and patient."""

from __future__ import annotations

import threading
import time as wall_clock
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.actuation.arm.arm import frames
from vrcaps.actuation.magnet_actuator import RobotActuator
from vrcaps.cockpit.messages import SetScene
from vrcaps.cockpit.scene.colorings import (
    Coloring,
    LiveWall,
    coarse_mesh,
    coloring_names,
    make_coloring,
)
from vrcaps.cockpit.scene.external_nodes import (
    CoilNodes,
    MagnetNode,
    PatientNode,
    link_meshes,
)
from vrcaps.cockpit.scene.nodes import (
    OrganNode,
    PatchNode,
    PathNode,
    add_capsule,
    cut_of,
    move,
)
from vrcaps.cockpit.scene.viewpoint import aim
from vrcaps.core.geometry import matrix_from_quaternion, transform_from
from vrcaps.magnet.presets import read_magnet

if TYPE_CHECKING:
    import viser

    from vrcaps.cockpit.session.clock import View
    from vrcaps.cockpit.session.seen_wall import SeenWall
    from vrcaps.cockpit.session.session import Session

GIZMO = "/drive/magnet"
"""Node of the gizmo in the scene."""

OPACITY = 0.6
"""Initial opacity of the organ."""

_SHORTEST, _LONGEST = 1.0 / 20.0, 1.0
"""Range of the time between updates of the scene [s]."""
_SLOW, _FAST = 15.0, 35.0
"""Frames per second below which updates become rarer, and above which more frequent."""
_RARER, _MORE_FREQUENT = 1.5, 0.85
"""Factors on the time between updates, per report of a browser."""
_STALE = 3.0
"""Age [s] above which a browser's report is ignored."""
_SECONDS_PER_WALL = 0.5
"""Real time between updates of the wall and its colors."""
_SECONDS_PER_PATCH = 0.2
"""Real time between updates of the contact patches."""
_SEE_THROUGH = 0.3
"""Opacity of the capsule when contact is colored."""
_ARM_COLOR, _PATH_COLOR = (225, 228, 232), (255, 190, 40)
_CAPSULE_ROOM = 1.5
"""Half the size of the box that frames the capsule, in lengths of the capsule."""


class Pace:
    """Time between updates of the scene, set by the slowest browser.

    A browser without a graphics card may take half a second for a frame of the scene, and all
    updates wait meanwhile. Each browser therefore reports its frame rate.

    Attributes:
        interval: Time between updates [s].
    """

    def __init__(self) -> None:
        self.interval = _SHORTEST
        self._rates: dict[int, tuple[float, float]] = {}

    def note(self, client: int, rate: float) -> None:
        """Register the frame rate of a browser [1/s]."""
        now = wall_clock.monotonic()
        self._rates[client] = (rate, now)
        self._rates = {
            known: (one, at) for known, (one, at) in self._rates.items() if now - at < _STALE
        }
        slowest = min(known for known, _ in self._rates.values())
        if slowest < _SLOW:
            self.interval = min(_LONGEST, _RARER * self.interval)
        elif slowest > _FAST:
            self.interval = max(_SHORTEST, _MORE_FREQUENT * self.interval)


class LiveScene:
    """Nodes of a drive, moved as often as browsers can draw them.

    Attributes:
        settings: Display settings; may be set at any time.
        pace: Time between updates.
        legend: Colors and labels of the current coloring.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        session: Session,
        seen: SeenWall,
        on_drag: Callable[[Any, np.ndarray, bool], None],
    ) -> None:
        """Add all nodes.

        Args:
            server: Server of the scene.
            session: Session to show.
            seen: Wall seen by the cameras.
            on_drag: Called with the ID of a scene's connection, the pose of the dragged gizmo, and
                whether it is still dragged.
        """
        self.pace, self._seen, self._session = Pace(), seen, session
        self._program, coils = session.rollout.program, session.rollout.coils
        self._server, self._model, self._scene = server, session.model, server.scene
        names = coloring_names(self._model.organ, is_live=True)
        self.settings = SetScene(names[0], OPACITY, "capsule", 0.5, True, True)
        self.legend: list[tuple[list[int], str]] = []
        self._mesh = coarse_mesh(self._model.vertices_world, self._model.organ.faces)
        self._organ, self._touched = OrganNode(self._scene, self._mesh), PatchNode(self._scene)
        self._coloring: Coloring | None = None
        self._drawn: tuple[object, ...] = ()
        self._moved, self._wall_time, self._patch_time = 0.0, 0.0, 0.0
        device = self._model.device
        self._capsule = add_capsule(self._scene, "/capsule", device.length, device.radius)
        self._magnet = None
        if self._program is not None:
            self._magnet = MagnetNode(self._scene, read_magnet(self._program.settings.magnet))
        self._coils = None if coils is None else CoilNodes(self._scene, coils)
        self._patient = PatientNode(self._scene, self._model.organ.vertices)
        self._path = PathNode(self._scene, "/path", _PATH_COLOR)
        self._arm_frames = self._add_arm()
        self._on_drag, self._is_dragged, self._dragging = on_drag, False, threading.Lock()
        if self._magnet is not None:
            self._gizmo = self._scene.add_transform_controls(GIZMO, scale=0.12, depth_test=False)
            self._gizmo.on_update(self._follow)
        aim(server, *self.box("all"))

    def box(self, target: str) -> tuple[np.ndarray, np.ndarray]:
        """Corners of the box around a target in the world [m], see `FrameView`."""
        view = self._session.view
        if target == "capsule" and view is not None:
            place = view.state.T_world_capsule[:3, 3]
            half = np.full(3, _CAPSULE_ROOM * self._model.device.length)
            return place - half, place + half
        points = self._model.vertices_world if view is None else self._points(view)
        low, high = points.min(axis=0), points.max(axis=0)
        if target == "all" and self._coils is not None:
            low = np.minimum(low, self._coils.box[0])
            high = np.maximum(high, self._coils.box[1])
        elif target == "all" and self._program is not None and self._magnet is not None:
            pose = self._program.controller.requested if view is None else view.T_world_magnet
            low = np.minimum(low, pose[:3, 3] - self._magnet.radius)
            high = np.maximum(high, pose[:3, 3] + self._magnet.radius)
        return low, high

    def update(self, view: View) -> None:
        """Move all nodes, as often as browsers can draw them."""
        now = wall_clock.monotonic()
        if now - self._moved < self.pace.interval:
            return
        self._moved = now
        move(self._capsule, view.state.T_world_capsule)
        self._path.add(view.state.time, view.state.T_world_capsule[:3, 3])
        if self._magnet is not None:
            self._magnet.show(view.T_world_magnet, has_lines=self.settings.has_lines)
            self._move_arm(view)
            self._move_gizmo(view)
        if self._coils is not None and view.coils is not None:
            self._coils.show(view.coils.state.currents)
        self._patient.show(view.T_world_patient, is_visible=self.settings.has_patient)
        if now - self._wall_time > _SECONDS_PER_WALL:
            self._wall_time = now
            self._draw_wall(view)
            self._path.draw()
        if now - self._patch_time > _SECONDS_PER_PATCH and self._coloring is not None:
            self._patch_time = now
            self._touched.draw(
                self._coloring.patches(self._points(view), view.state.T_world_capsule)
            )

    def _points(self, view: View) -> np.ndarray:
        """Vertices of the fine wall [m]."""
        moved = view.state.vertices_world
        return self._model.vertices_world if moved is None else moved

    def _draw_wall(self, view: View) -> None:
        """Redraw the wall if its colors or its cut have changed; otherwise move it."""
        points, settings = self._points(view), self.settings
        if self._coloring is None or self._coloring.name != settings.coloring:
            world = self._session.rollout.world
            live = LiveWall(self._seen, world.tissue.foundation_in_series, world.body)
            organ = self._model.organ
            self._coloring = make_coloring(settings.coloring, organ, self._mesh, live)
            body: Any = self._scene.get_handle_by_name("/capsule/body")
            body.opacity = _SEE_THROUGH if self._coloring.hides_capsule else None
        radius, pose = self._model.device.radius, view.state.T_world_capsule
        cut = cut_of(settings.cut, settings.cut_fraction, pose, radius)
        wanted = (settings.coloring, cut, self._coloring.version)
        self._organ.set_opacity(settings.opacity)
        if wanted != self._drawn:
            self._drawn = wanted
            self._organ.draw(points, self._coloring, cut)
            self.legend = [(list(color), text) for color, text in self._coloring.legend()]
        else:
            self._organ.move(points)

    def _move_arm(self, view: View) -> None:
        assert self._program is not None
        actuator = self._program.controller.actuator
        if isinstance(actuator, RobotActuator) and self._arm_frames:
            placed = frames(actuator.robot.arm, view.joint_angles)
            poses = actuator.robot.T_world_base @ np.concatenate([np.eye(4)[None], placed])
            for number, handle in self._arm_frames.items():
                move(handle, poses[number])

    def _move_gizmo(self, view: View) -> None:
        """Keep the gizmo at the magnet unless it is being dragged."""
        with self._dragging:
            if not (self._is_dragged or self._session.operator.is_dragged):
                move(self._gizmo, view.T_world_requested)

    def _follow(self, event: Any) -> None:
        rotation = matrix_from_quaternion(np.array(self._gizmo.wxyz, float))
        pose = transform_from(rotation, np.array(self._gizmo.position, float))
        with self._dragging:
            self._is_dragged = event.phase != "end"
        self._on_drag(event.client_id, pose, self._is_dragged)

    def _add_arm(self) -> dict[int, Any]:
        """Add nodes of the arm's links, by frame; empty without an arm."""
        actuator = self._program and self._program.controller.actuator
        if not isinstance(actuator, RobotActuator):
            return {}
        placed = {}
        for number, (vertices, faces) in link_meshes(actuator.robot.arm).items():
            placed[number] = self._scene.add_frame(f"/arm/{number}", show_axes=False)
            name = f"/arm/{number}/link"
            self._scene.add_mesh_simple(name, vertices, faces, color=_ARM_COLOR)
        return placed
