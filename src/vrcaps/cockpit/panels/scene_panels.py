"""Panels of the patient, of the next drive, and of the 3D view with organ, capsule and magnet."""

from __future__ import annotations

import time as wall_clock
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.actuation.arm.arm import frames
from vrcaps.actuation.magnet_actuator import RobotActuator
from vrcaps.anatomy.catalog import ORGANS
from vrcaps.camera_pipeline.effect.base import MAX_SEVERITY
from vrcaps.camera_pipeline.effects import EFFECTS
from vrcaps.cockpit.scene.colorings import (
    Coloring,
    LiveWall,
    coarse_mesh,
    coloring_names,
    make_coloring,
)
from vrcaps.cockpit.scene.external_nodes import MagnetNode, PatientNode, link_meshes
from vrcaps.cockpit.scene.nodes import (
    CUT_AXES,
    Cut,
    OrganNode,
    PatchNode,
    PathNode,
    add_capsule,
    aim,
    move,
)
from vrcaps.cockpit.session.drive import (
    CONTENTS,
    LASTING_EFFECTS,
    Choice,
    chosen_scenario,
    magnetic_capsules,
)
from vrcaps.magnet.presets import read_magnet
from vrcaps.scenario.scenario import OrganGenerated
from vrcaps.world.model import POSTURES

if TYPE_CHECKING:
    from vrcaps.cockpit.page import Page
    from vrcaps.cockpit.session.clock import View


class PatientPanel:
    """Controls that turn the patient, inflate or deflate the gut, rinse it, and start phase III."""

    def __init__(self, page: Page) -> None:
        session = page.session
        gui = page.server.gui
        with gui.add_folder("Patient", expand_by_default=False):
            posture = gui.add_dropdown("Posture", POSTURES, initial_value=session.scenario.posture)
            turn = gui.add_button("Turn the patient")
            factor = gui.add_slider("Insufflation", 0.6, 1.6, 0.05, 1.0)
            inflate = gui.add_button("Set insufflation")
            flush = gui.add_button("Flush", hint="Remove bubbles and chyme around the capsule")
            phase = gui.add_button(
                "Start phase III", hint="Start the strongest contractions, at the capsule"
            )
        turn.on_click(page.for_driver(lambda: session.turn(posture.value)))
        flush.on_click(page.for_driver(session.flush))
        phase.on_click(page.for_driver(session.start_phase_three))
        inflate.on_click(page.for_driver(lambda: session.insufflate(float(factor.value))))

    def update(self, view: View) -> None:
        """Do nothing: the scene shows the patient."""


_SAME = "unchanged"


class NewDrivePanel:
    """Controls that end the drive, which is saved, and start another one with the choices made."""

    def __init__(self, page: Page) -> None:
        self._page, self._session = page, page.session
        scenario, gui = page.session.scenario, page.server.gui
        organ = scenario.organ
        self._seed_before = organ.seed if isinstance(organ, OrganGenerated) else 0
        with gui.add_folder("New drive", expand_by_default=False):
            gui.add_markdown("The current drive is saved. All other settings stay unchanged.")
            self._organ = gui.add_dropdown("Organ", (_SAME, *ORGANS))
            self._seed = gui.add_number("Patient", self._seed_before, min=0, step=1)
            self._lesions = gui.add_text(
                "Lesions",
                "",
                hint="Such as polyp-Ip:size=12mm colitis-2, prevalence, or none; empty: unchanged",
            )
            self._capsule = gui.add_dropdown("Capsule", (_SAME, *magnetic_capsules()))
            self._file = gui.add_text("Capsule file", "", hint="A device file (TOML); empty: none")
            with gui.add_folder("Contents and camera", expand_by_default=False):
                self._sliders = {
                    name: self._slider(name, getattr(scenario.contents, name), f"Of {name}")
                    for name in CONTENTS
                } | {
                    name: self._slider(
                        name, getattr(scenario.effects, name), EFFECTS[name].summary()
                    )
                    for name in LASTING_EFFECTS
                }
            button = gui.add_button("Start a new drive")
        self._before = {name: slider.value for name, slider in self._sliders.items()}
        button.on_click(page.for_driver(self._start_drive))

    def update(self, view: View) -> None:
        """Do nothing: the drive shows the choices."""

    def _slider(self, name: str, given: Any, hint: str) -> Any:
        first = given if isinstance(given, int) else 0
        label, gui = name.replace("_", " "), self._page.server.gui
        return gui.add_slider(label, 0, MAX_SEVERITY, 1, first, hint=hint)

    def _start_drive(self) -> None:
        file = self._file.value.strip()
        if file:
            self._page.require_here("A file")
        self._page.start_drive(chosen_scenario(self._session.scenario, self._choice(file)))

    def _choice(self, file: str) -> Choice:
        """Changes made in the page; an exact value is kept until its slider is moved."""
        moved = {
            name: int(slider.value)
            for name, slider in self._sliders.items()
            if slider.value != self._before[name]
        }
        organ, capsule, seed = self._organ.value, self._capsule.value, int(self._seed.value)
        return Choice(
            organ=None if organ == _SAME else organ,
            seed=None if seed == self._seed_before else seed,
            lesions=self._lesions.value,
            capsule=file or (None if capsule == _SAME else capsule),
            contents={name: value for name, value in moved.items() if name in CONTENTS},
            effects={name: value for name, value in moved.items() if name in LASTING_EFFECTS},
        )


_SECONDS_PER_WALL = 0.5
"""Real time between updates of the wall and its colors."""
_SECONDS_PER_PATCH = 0.2
"""Real time between updates of the contact patches."""
_SEE_THROUGH = 0.3
"""Opacity of the capsule when contact is colored."""
_ARM_COLOR, _PATH_COLOR = (225, 228, 232), (255, 190, 40)


class ScenePanel:
    """3D scene, and its display settings."""

    def __init__(self, page: Page) -> None:
        program = page.session.rollout.program
        assert program is not None
        self._page, self._session, self._program = page, page.session, program
        self._model, self._scene = page.session.model, page.server.scene
        self._mesh = coarse_mesh(self._model.vertices_world, self._model.organ.faces)
        self._organ, self._touched = OrganNode(self._scene, self._mesh), PatchNode(self._scene)
        self._coloring: Coloring | None = None
        self._drawn: tuple[object, ...] = ()
        self._moved, self._wall_time, self._patch_time = 0.0, 0.0, 0.0
        self._add_controls()
        points, magnet = self._model.vertices_world, program.controller.requested[:3, 3]
        aim(page.server, points.min(axis=0), np.maximum(points.max(axis=0), magnet))
        device = self._model.device
        self._capsule = add_capsule(self._scene, "/capsule", device.length, device.radius)
        self._magnet = MagnetNode(self._scene, read_magnet(program.settings.magnet))
        self._patient = PatientNode(self._scene, self._model.organ.vertices)
        self._path = PathNode(self._scene, "/path", _PATH_COLOR)
        self._arm_frames = self._add_arm()

    def update(self, view: View) -> None:
        """Move all nodes, as often as browsers can draw them."""
        now = wall_clock.monotonic()
        if now - self._moved < self._page.pace.interval:
            return
        self._moved = now
        move(self._capsule, view.state.T_world_capsule)
        self._path.add(view.state.time, view.state.T_world_capsule[:3, 3])
        self._magnet.show(view.T_world_magnet, has_lines=self._has_lines.value)
        self._patient.show(view.T_world_patient, is_visible=self._has_patient.value)
        actuator = self._program.controller.actuator
        if isinstance(actuator, RobotActuator) and self._arm_frames:
            placed = frames(actuator.robot.arm, view.joint_angles)
            poses = actuator.robot.T_world_base @ np.concatenate([np.eye(4)[None], placed])
            for number, handle in self._arm_frames.items():
                move(handle, poses[number])
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
        """Redraw the wall if its colors have changed; otherwise move it."""
        points = self._points(view)
        if self._coloring is None or self._coloring.name != self._color.value:
            world = self._session.rollout.world
            live = LiveWall(self._page.seen, world.tissue.foundation_in_series, world.body)
            name, organ = self._color.value, self._model.organ
            self._coloring = make_coloring(name, organ, self._mesh, live)
            body: Any = self._scene.get_handle_by_name("/capsule/body")
            body.opacity = _SEE_THROUGH if self._coloring.hides_capsule else None
        cut = Cut(self._cut_axis.value, self._cut_fraction.value)
        wanted = (self._color.value, cut, self._coloring.version)
        self._organ.set_opacity(self._opacity.value)
        if wanted != self._drawn:
            self._drawn = wanted
            self._organ.draw(points, self._coloring, cut)
            self._legend.content = self._coloring.legend()
        else:
            self._organ.move(points)

    def _add_controls(self) -> None:
        """Add the display settings."""
        gui = self._page.server.gui
        with gui.add_folder("Scene", expand_by_default=False):
            names = coloring_names(self._model.organ, is_live=True)
            self._color = gui.add_dropdown("Coloring", names)
            self._opacity = gui.add_slider("Opacity", 0.1, 1.0, 0.05, 0.35)
            self._cut_axis = gui.add_dropdown("Cutting axis", CUT_AXES)
            self._cut_fraction = gui.add_slider("Cutting position", 0.0, 1.0, 0.05, 0.5)
            self._has_lines = gui.add_checkbox("Field lines", True)
            self._has_patient = gui.add_checkbox("Patient and table", True)
            self._legend = gui.add_markdown("")

    def _add_arm(self) -> dict[int, Any]:
        """Add nodes of the arm's links, by frame; empty without an arm."""
        actuator = self._program.controller.actuator
        if not isinstance(actuator, RobotActuator):
            return {}
        placed = {}
        for number, (vertices, faces) in link_meshes(actuator.robot.arm).items():
            placed[number] = self._scene.add_frame(f"/arm/{number}", show_axes=False)
            name = f"/arm/{number}/link"
            self._scene.add_mesh_simple(name, vertices, faces, color=_ARM_COLOR)
        return placed
