"""Simulation thread: consumes commands, publishes snapshots."""

from __future__ import annotations

import math
import shutil
import threading
import time as wall_clock
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.cockpit.session.clock import Clock, View
from vrcaps.cockpit.session.drive import Drive, cockpit_scenario, make_folder
from vrcaps.cockpit.session.operator import Operator
from vrcaps.core.errors import InputError, UnknownNameError, VrcapsError
from vrcaps.motion.rollout import Rollout
from vrcaps.recording.resume import with_stored_organ
from vrcaps.scenario.build import build
from vrcaps.scenario.scenario import Scenario
from vrcaps.tissue.motility.migrating_complex import Front
from vrcaps.world.model import posture_transform
from vrcaps.world.schedule import (
    Flush,
    Insufflation,
    PostureChange,
    insufflation_at,
    patient_at,
)

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.camera_pipeline.effects import Effects
    from vrcaps.motion.motion import MotionState
    from vrcaps.motion.rollout import Moment
    from vrcaps.render.settings import RenderSettings

TURN_SECONDS = 5.0
"""Duration of a turn of the patient."""

INFLATE_SECONDS = 3.0
"""Duration of a change of insufflation."""

FRONT_SECONDS = 2.0
"""Minimum time between starts of phase III."""

_SECONDS_PER_VIEW = 1.0 / 40.0
"""Minimum real time between views."""

_SECONDS_PER_SAVE = 1.0
"""Real time between saves of the drive."""

_AHEAD = 0.1
"""Delay [s] of a requested turn or insufflation, to start later than all completed steps."""


_WEAK = 0.5
"""Fraction of the commanded force of coils below which they count as too weak."""


class _Jump(Exception):
    """Ends a walk through the rollout, to jump to another checkpoint or to close."""


class Session:
    """Interactive simulation: steps a rollout in real time, without waiting for viewers.

    All methods may be called from any thread. `view` is the latest instant.

    Attributes:
        scenario: Simulated scenario.
        model: Organ and capsule.
        rollout: Simulation.
        clock: Paces and pauses the simulation.
        operator: Steers the magnet or the coils.
        drive: Files of the drive.
        on_message: Called with each message for the user.
    """

    def __init__(
        self,
        scenario: Scenario,
        folder: Path,
        *,
        on_message: Callable[[str], None] = lambda text: None,
    ) -> None:
        """Build the world.

        Args:
            scenario: Scenario to simulate, see `cockpit_scenario`.
            folder: New or empty folder for the drive; a new one is removed on failure.
            on_message: Called with each message for the user.

        Raises:
            InputError: If the scenario is invalid or the folder is not empty.
        """
        is_new = not folder.exists()
        make_folder(folder)
        try:
            resolved = cockpit_scenario(with_stored_organ(scenario, folder))
            self.scenario = resolved.scenario
            self.model, rollout = build(resolved)
        except BaseException:
            if is_new:
                shutil.rmtree(folder, ignore_errors=True)
            raise
        self.on_message = on_message
        assert isinstance(rollout, Rollout)
        program = rollout.program or rollout.coils
        assert program is not None
        self.rollout = rollout
        self.clock, self.operator = Clock(), Operator(program)
        program.operator = self.operator
        self.drive = Drive(folder, self.operator, self.scenario_so_far)
        self.view: View | None = None
        self._lock = threading.Lock()
        self._poses: list[Float[np.ndarray, "4 4"]] = []
        self._snapshots: dict[str, MotionState] = {}
        self._last: MotionState | None = None
        self._goto: tuple[MotionState | None] | None = None
        self._is_closed = False
        self._published = (0, 0.0)
        self._saved = threading.Event()
        self._threads = [
            threading.Thread(target=run, name=f"vrcaps-{name}", daemon=True)
            for name, run in (("simulation", self._run), ("save", self._autosave))
        ]

    def start(self) -> None:
        """Start the simulation and the saving."""
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """Stop the simulation and save the drive."""
        self._is_closed = True
        self.clock.wake()
        self._saved.set()
        for thread in self._threads:
            if thread.is_alive():
                thread.join()
        self._save()

    @property
    def poses(self) -> Float[np.ndarray, "n 4 4"]:
        """`T_world_capsule` of each completed frame."""
        with self._lock:
            return np.array(self._poses).reshape(-1, 4, 4)

    @property
    def snapshots(self) -> tuple[str, ...]:
        """Names of the available snapshots."""
        return tuple(self._snapshots)

    @property
    def has_contents(self) -> bool:
        """True if the lumen contains bubbles or chyme, which a flush removes."""
        contents = self.rollout.model.lumen_contents
        return contents is not None and len(contents.spheres) > 0

    def scenario_so_far(self) -> Scenario:
        """Scenario of the drive so far: completed frames, turns and insufflations."""
        with self._lock:
            frames = max(1, len(self._poses))
        return replace(self.scenario, motion=self.rollout.settings, frames=frames)

    def step_frame(self) -> None:
        """Pause after one more frame."""
        with self._lock:
            frame = len(self._poses)
        self.clock.run(until=frame / self.rollout.fps + 1e-6)

    def keep_snapshot(self) -> str:
        """Store the last completed frame; return the name of the snapshot.

        Raises:
            InputError: If there is no frame yet.
        """
        with self._lock:
            state = self._last
            if state is None:
                raise InputError("No frame is complete. Wait for the first frame.")
            name = f"{state.frame / self.rollout.fps:.2f} s"
            self._snapshots[name] = state
            return name

    def go_back(self, name: str) -> None:
        """Rewind to a snapshot; later commands are dropped.

        Raises:
            UnknownNameError: If there is no such snapshot.
        """
        if name not in self._snapshots:
            raise UnknownNameError("snapshot", name, self._snapshots)
        self._jump(self._snapshots[name])

    def reset(self) -> None:
        """Rewind to the first frame."""
        self._jump(None)

    def turn(self, posture: str) -> None:
        """Turn the patient.

        Raises:
            InputError: If the patient is still being turned.
            UnknownNameError: If there is no such posture.
        """
        posture_transform(posture)
        start_time, settings = self._command_time(), self.rollout.settings
        changes = settings.posture_changes
        if changes and start_time < changes[-1].time + changes[-1].duration:
            raise InputError(f"The patient is still turning to {changes[-1].posture}.")
        changes = (*changes, PostureChange(posture, start_time, TURN_SECONDS))
        self.rollout.change(replace(settings, posture_changes=changes))

    def insufflate(self, factor: float) -> None:
        """Inflate or deflate the gut to a factor on its radius.

        Raises:
            InputError: If the factor is invalid or a change is in progress.
        """
        start_time, settings = self._command_time(), self.rollout.settings
        entries = settings.insufflation
        if entries and start_time <= entries[-1].time:
            raise InputError("The previous change of insufflation is still in progress.")
        now = insufflation_at(entries, start_time)
        ramp = (Insufflation(start_time, now), Insufflation(start_time + INFLATE_SECONDS, factor))
        self.rollout.change(replace(settings, insufflation=(*entries, *ramp)))

    def flush(self) -> None:
        """Wash off bubbles and chyme around the capsule.

        Raises:
            InputError: If there are none, or a flush is in progress.
        """
        start_time, settings = self._command_time(), self.rollout.settings
        if not self.has_contents:
            raise InputError(
                "The lumen contains neither bubbles nor chyme. Start a new drive that has them."
            )
        flushes = settings.flushes
        if flushes and start_time <= flushes[-1].time + flushes[-1].duration:
            raise InputError("The previous flush is still in progress.")
        self.rollout.change(replace(settings, flushes=(*flushes, Flush(start_time))))

    def start_phase_three(self) -> None:
        """Start phase III of the migrating motor complex at the capsule.

        Raises:
            InputError: If it does not occur there, or has just started.
            UnknownNameError: If there is no muscle for a segment of the wall.
        """
        self.rollout.add_muscle()
        start_time, settings = self._command_time(), self.rollout.settings
        fronts = settings.phase_three
        if fronts and start_time < fronts[-1].time + FRONT_SECONDS:
            raise InputError("Phase III has already started.")
        fronts = (*fronts, Front(start_time, self.rollout.front_arc_length))
        self.rollout.change(replace(settings, phase_three=fronts))

    def change_render(self, render: RenderSettings, effects: Effects) -> None:
        """Set light, imaging and effects of later recordings; the simulation does not change."""
        self.scenario = replace(self.scenario, render=render, effects=effects)

    def _command_time(self) -> float:
        """Next tenth of a second [s] that no step has reached yet."""
        return math.ceil(10.0 * (max(0.0, self.rollout.world.time) + _AHEAD)) / 10.0

    def _jump(self, state: MotionState | None) -> None:
        with self._lock:
            self._goto = (state,)
        self.clock.wake()

    def _run(self) -> None:
        """Run the simulation; the thread's function."""
        start: MotionState | None = None
        while not self._is_closed:
            try:
                self._rewind(start)
                for moment in self.rollout.moments(start, self._tick, _always):
                    self._keep(moment)
            except _Jump:
                with self._lock:
                    start = self._goto[0] if self._goto else self._last
                    self._goto = None
            except VrcapsError as error:
                start = self._last
                self.clock.pause()
                self.on_message(f"{error} Paused at the last frame: resume, rewind or reset.")
                time = 0.0 if start is None else start.frame / self.rollout.fps
                while self.clock.holds(time) and not (self._is_closed or self._goto):
                    self._saved.wait(0.05)
                if self._goto:
                    start, self._goto = self._goto[0], None

    def _rewind(self, state: MotionState | None) -> None:
        """Drop everything after a checkpoint."""
        frame = 0 if state is None else state.frame
        time = frame / self.rollout.fps
        self.operator.rewind(time)
        settings = self.rollout.settings
        turns = tuple(change for change in settings.posture_changes if change.time <= time)
        entries = settings.insufflation
        ramps = list(zip(entries[::2], entries[1::2], strict=True))
        kept = tuple(entry for ramp in ramps if ramp[0].time <= time for entry in ramp)
        flushes = tuple(flush for flush in settings.flushes if flush.time <= time)
        fronts = tuple(front for front in settings.phase_three if front.time <= time)
        commands = {"insufflation": kept, "flushes": flushes, "phase_three": fronts}
        self.rollout.change(replace(settings, posture_changes=turns, **commands))
        with self._lock:
            self._last = state
            del self._poses[frame:]
            self._snapshots = {
                name: kept for name, kept in self._snapshots.items() if kept.frame <= frame
            }

    def _keep(self, moment: Moment) -> None:
        """Store a completed frame and its checkpoint."""
        with self._lock:
            self._poses[moment.index :] = [moment.state.T_world_capsule]
            self._last = moment.checkpoint or self._last

    def _tick(self, simulated: float, duration: float) -> None:
        """Publish a step and wait until the next is due; called after each step."""
        del simulated, duration
        time = self.rollout.world.time
        self._publish()
        if time >= 0.0:
            self.clock.wait(time)
        if self._is_closed or self._goto is not None:
            raise _Jump

    def _publish(self) -> None:
        """Publish a view, if the last is old enough or time is about to stop."""
        index, published = self._published
        now = wall_clock.perf_counter()
        if now - published < _SECONDS_PER_VIEW and not self.clock.is_paused:
            return
        self._published = (index + 1, now)
        world = self.rollout.world
        self.view = View(
            index=index + 1,
            frame=max(0, len(self._poses) - 1),
            state=world.state,
            T_world_patient=patient_at(
                self.model.T_world_patient, self.rollout.settings.posture_changes, world.time
            ),
            **_actuator_values(self.rollout),
            achieved_speed=self.clock.achieved,
            is_paused=self.clock.is_paused,
        )

    def _autosave(self) -> None:
        """Save the drive periodically; the thread's function."""
        while not self._saved.wait(_SECONDS_PER_SAVE):
            self._save()

    def _save(self) -> None:
        try:
            self.drive.save()
        except OSError as error:
            self.on_message(f"Cannot save the drive in {self.drive.folder}: {error.strerror}.")


def _actuator_values(rollout: Rollout) -> dict[str, Any]:
    """Values of a view of the magnet, or of the coils."""
    if rollout.coils is not None:
        program = rollout.coils
        coupling, force = rollout.world.state.coupling, program.target[:3]
        reached = 0.0 if coupling is None else float(coupling.force_world @ force)
        is_weak = reached < _WEAK * float(force @ force)
        return {
            "T_world_magnet": program.T_world_array,
            "T_world_requested": program.T_world_array,
            "joint_angles": np.zeros(0),
            "limit": program.reached_limit,
            "lost": "insufficient_force" if is_weak else "",
            "coils": program.status,
        }
    assert rollout.program is not None
    controller = rollout.program.controller
    actuator = controller.status.actuator
    return {
        "T_world_magnet": actuator.T_world_magnet,
        "T_world_requested": controller.requested,
        "joint_angles": actuator.joint_angles,
        "limit": actuator.limit,
        "lost": controller.status.lost,
    }


def _always() -> bool:
    return True
