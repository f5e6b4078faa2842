"""Rollout of a simulation: steps the world from frame to frame, one state at a time."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.actuation.coil_program import CoilProgram
from vrcaps.actuation.steering_program import SteeringProgram
from vrcaps.core.errors import InputError
from vrcaps.core.fields import path_of
from vrcaps.core.geometry import invert, transform_from, transform_points
from vrcaps.core.units import CM
from vrcaps.magnet.presets import read_magnet
from vrcaps.motion.dynamics_settings import DynamicsSettings, motion_row
from vrcaps.motion.motion import Command, MotionState, Step, with_neighbors
from vrcaps.motion.trajectory import start_pose
from vrcaps.organ.surface import OrganSurface
from vrcaps.tissue.motility.motility import Motility
from vrcaps.world.control import Control
from vrcaps.world.model import Model, State, mean_contact, mean_coupling
from vrcaps.world.schedule import (
    flush_between,
    in_world,
    insufflation_at,
    patient_at,
    read_wrenches,
    wrench_at,
)
from vrcaps.world.snapshot import snapshot_arrays, snapshot_from_arrays
from vrcaps.world.wall_displacement import ShownWall
from vrcaps.world.world import World

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.magnet.sources import Source

_PASSED = 5.0 * CM
"""Distance of the front of phase III beyond the capsule in the first frame: less than the 9 cm that
phase III covers where its front is slowest, the terminal ileum, at 0.9 cm/min for 10 min."""

_NEARBY = 3.0 * CM
"""Search range of the capsule's arc length, from its value one step earlier."""


@dataclass(frozen=True)
class Moment:
    """A simulated frame.

    Attributes:
        index: Index of the frame.
        state: State of the world at the frame.
        command: Commands since the previous frame.
        checkpoint: Checkpoint of the simulation, if one was due.
    """

    index: int
    state: State
    command: Command
    checkpoint: MotionState | None


class Rollout:
    """Simulated motion: a `Motion` that steps a `World` from frame to frame."""

    def __init__(
        self,
        model: Model,
        settings: DynamicsSettings,
        *,
        frames: int,
        fps: float,
        seed: int,
        shown: OrganSurface | None = None,
    ) -> None:
        """Place the capsule in the organ.

        Args:
            model: The lumen and the capsule.
            settings: Settings of the motion.
            frames: Number of frames, at least 1.
            fps: Frames per second.
            seed: Seed of the patient's muscle, 0 or more.
            shown: Another organ with the same triangles, such as the clean twin: its wall moves
                like the model's and is stored in the states.

        Raises:
            InputError: If the capsule does not fit anywhere, a setting is impossible, or the
                triangles of the other organ differ.
            UnknownNameError: If the tissue has no muscle for a segment of the wall.
        """
        self.model, self.settings = model, settings
        self.frames, self.fps = frames, fps
        file = settings.wrench_file
        self._wrenches = settings.wrenches if file is None else read_wrenches(path_of(file))
        self._line = model.organ.centerline
        self._shown_wall = ShownWall(model, shown)
        pose, arc_length, self.notes = start_pose(model, settings.start, settings.angle)
        self._arc_length = arc_length
        self.program = self.coils = None
        sources: tuple[Source, ...] = ()
        if settings.magnet is not None:
            self.program = SteeringProgram(model, settings.magnet, pose, arc_length, seed=seed)
            self.notes += self.program.notes
            sources = tuple(self.program.controller.sources)
        elif settings.coils is not None:
            self.coils = CoilProgram(model, settings.coils)
            sources = self.coils.sources
        self.world = World(
            model,
            settings.make_tissue(front=self.front_arc_length),
            State(-settings.settle, pose),
            substep=settings.substep,
            dynamics=settings.dynamics,
            seed=seed,
            sources=sources,
        )
        self._require_phase(arc_length)
        self._require_time()
        self._begin = self._save(0)
        self._checkpoint: MotionState | None = None

    def __len__(self) -> int:
        return self.frames

    @property
    def duration(self) -> float:
        """Simulated time, including settling [s]."""
        return self.settings.settle + (self.frames - 1) / self.fps

    def change(self, settings: DynamicsSettings) -> None:
        """Change commands: posture, insufflation, flushes, fronts of phase III.

        The result is the same as if they had been known from the start, provided that no step has
        reached a command that was added or removed.

        Args:
            settings: Current settings, except for these commands.

        Raises:
            InputError: If no phase III front passes a position at which one starts.
            UnknownNameError: If there is no muscle for a segment of the wall.
        """
        if settings.phase_three != self.settings.phase_three:
            self.add_muscle()
            self.world.begin_fronts(settings.phase_three)
        self.settings = settings

    def add_muscle(self) -> None:
        """Create the muscle, which takes a while, if there is none; it rests until commanded.

        Raises:
            UnknownNameError: If there is no muscle for a segment of the wall.
        """
        fallback = self.settings.fallback_segment
        self.world.add_muscle(Motility(fallback_segment=fallback, is_asleep=True))

    @property
    def front_arc_length(self) -> float:
        """Arc length where a front of phase III has just passed the capsule [m]."""
        return min(self._arc_length + _PASSED, self._line.length)

    @property
    def arc_length(self) -> float:
        """Arc length of the capsule after the last step [m]."""
        return self._arc_length

    def checkpoint(self) -> MotionState | None:
        """Return the simulation at the last step yielded, if due; see `Motion.checkpoint`."""
        return self._checkpoint

    def steps(
        self,
        resume: MotionState | None = None,
        *,
        progress: Callable[[float, float], None] | None = None,
        is_due: Callable[[], bool] | None = None,
    ) -> Iterator[Step]:
        """Iterate over the frames with their neighbors, see `Motion.steps`.

        Raises:
            InputError: If the world cannot be stepped; the message states the time.
        """
        moments = self.moments(resume, progress or _silent, is_due or _never)
        for previous, moment, following in with_neighbors(moments):
            if resume is not None and previous is None:
                continue  # the frame of the checkpoint was already yielded
            self._checkpoint = moment.checkpoint
            yield Step(
                moment.index,
                moment.state,
                previous=None if previous is None else previous.state,
                next=None if following is None else following.state,
                command=moment.command,
            )

    def columns(self, step: Step) -> dict[str, float | str]:
        """Contact, commands and, with a steering magnet, its coupling."""
        assert step.command is not None
        return motion_row(step.state, step.command)

    def sources(self, step: Step) -> tuple[Source, ...]:
        """Return the steering magnet, or the coils with their currents as strengths."""
        command, magnet = step.command, self.settings.magnet
        if command is not None and command.coils is not None and self.coils is not None:
            return self.coils.powered(command.coils)
        if command is None or command.controller is None or magnet is None:
            return ()
        return (read_magnet(magnet.magnet, command.controller.actuator.T_world_magnet),)

    def moments(
        self,
        resume: MotionState | None,
        progress: Callable[[float, float], None],
        is_due: Callable[[], bool],
    ) -> Iterator[Moment]:
        """Iterate over frames from the first or a checkpoint's, each as soon as it is simulated.

        Args:
            resume: A checkpoint, whose frame comes first; None starts with frame 0.
            progress: Called after each step with the time simulated so far and the total time [s].
            is_due: Called at each frame; returns whether it should have a checkpoint.

        Raises:
            InputError: If the checkpoint is damaged or the world cannot be stepped.
        """
        self._restore(resume or self._begin)
        first = 0
        if resume is not None:
            first, time = resume.frame + 1, resume.frame / self.fps
            command = self._command(time, np.zeros((2, 3)))
            yield Moment(resume.frame, self._shown(self.world.state, time, command), command, None)
        for index in range(first, self.frames):
            start = (index - 1) / self.fps if index else -self.settings.settle
            state, command = self._advance(start, index / self.fps, progress)
            yield Moment(index, state, command, self._save(index) if is_due() else None)

    def _save(self, frame: int) -> MotionState:
        program = self.program or self.coils
        controller = np.zeros(0) if program is None else program.to_array()
        snapshot = replace(self.world.snapshot(), controller=controller)
        arrays = snapshot_arrays(snapshot) | {"arc_length": np.array(self._arc_length)}
        return MotionState(frame, arrays)

    def _restore(self, state: MotionState) -> None:
        try:
            snapshot = snapshot_from_arrays(state.arrays)
            self._arc_length = float(state.arrays["arc_length"])
        except (ValueError, LookupError, TypeError) as error:
            raise InputError(f"The checkpoint of the motion is damaged: {error}.") from error
        self.world.restore(snapshot)
        if (program := self.program or self.coils) is not None:
            program.restore(snapshot.controller)

    def _advance(
        self, start: float, end: float, progress: Callable[[float, float], None]
    ) -> tuple[State, Command]:
        """Step the world from one time to another [s]."""
        steering = self.settings.magnet or self.settings.coils
        step = self.settings.step if steering is None else min(self.settings.step, steering.period)
        count = math.ceil((end - start) / step * (1.0 - 1e-9))
        contacts, couplings = [], []
        wrenches = np.zeros((max(count, 1), 2, 3))
        for index in range(count):
            times = [start + (end - start) * (index + k) / count for k in (0, 1)]
            wrenches[index] = self._wrench(times[0]) if start >= 0.0 else 0.0
            control = replace(
                self._source_control(times),
                force_world=wrenches[index, 0],
                torque_world=wrenches[index, 1],
                T_world_patient=self._patient(times[1]),
                insufflation=self._insufflation(times[1]),
                flush=flush_between(self.settings.flushes, *times),
            )
            try:
                self.world.step(control, times[1] - times[0])
            except InputError as error:
                raise InputError(f"At {times[0]:.3f} s of the simulation: {error}") from error
            contacts.append(self.world.contact)
            couplings.append(self.world.coupling)
            self._follow()
            progress(times[1] + self.settings.settle, self.duration)
        state = self.world.state
        if contacts:
            coupling = mean_coupling(couplings)
            state = replace(state, contact=mean_contact(contacts), coupling=coupling)
        command = self._command(end, wrenches.mean(axis=0))
        return self._shown(state, end, command), command

    def _source_control(self, times: list[float]) -> Control:
        """Command of the magnet or the coils between two times."""
        start, end = times
        if self.coils is not None:
            return self.coils.control(self.world, start, end - start)
        if self.program is None:
            return Control()
        return self.program.control(self.world, start, end - start, self._patient(end))

    def _shown(self, state: State, time: float, command: Command) -> State:
        """State of a frame at exactly its time, with the wall that images show."""
        moved = self._shown_wall.vertices_world(
            state, command.T_world_patient, command.insufflation
        )
        return replace(state, time=time, vertices_world=moved)

    def _wrench(self, time: float) -> Float[np.ndarray, "2 3"]:
        """Commanded force [N] and torque [N·m] in the world at a time."""
        wrench = wrench_at(self._wrenches, time)
        if self.settings.wrench_frame == "capsule":
            return in_world(wrench, self.world.T_world_capsule)
        if self.settings.wrench_frame == "gut":
            nearest = int(np.argmin(np.abs(self._line.arc_length - self._arc_length)))
            frame = transform_from(self._line.frames[nearest], np.zeros(3))
            return in_world(wrench, self._patient(time) @ frame)
        return wrench

    def _patient(self, time: float) -> Float[np.ndarray, "4 4"]:
        """Pose of the patient; the model's own matrix without changes of posture."""
        if not self.settings.posture_changes:
            return self.model.T_world_patient
        return patient_at(self.model.T_world_patient, self.settings.posture_changes, time)

    def _insufflation(self, time: float) -> float:
        """Factor on the lumen's radius; before the first frame it approaches its first value."""
        if time >= 0.0 or not self.settings.settle:
            return insufflation_at(self.settings.insufflation, max(time, 0.0))
        fraction = 1.0 + time / self.settings.settle
        first = insufflation_at(self.settings.insufflation, 0.0)
        return 1.0 + (first - 1.0) * fraction**2 * (3.0 - 2.0 * fraction)

    def _follow(self) -> None:
        """Update the capsule's arc length, searching near its last value."""
        to_patient = invert(self._patient(self.world.time))
        position = transform_points(to_patient, self.world.T_world_capsule[:3, 3])
        s = self._line.arc_length
        low, high = np.searchsorted(s, [self._arc_length - _NEARBY, self._arc_length + _NEARBY])
        near = self._line.points[low:high]
        if len(near):
            self._arc_length = float(s[low + np.argmin(((near - position) ** 2).sum(axis=1))])

    def _command(self, time: float, wrench: Float[np.ndarray, "2 3"]) -> Command:
        muscle = self.world.muscle
        phase = 0 if muscle is None else int(muscle.phase(np.array(self._arc_length), time))
        inflated = self._insufflation(time)
        status, estimate = None, None
        if self.program is not None:
            status = self.program.controller.status
            self.program.observe(self.world)
            tracker = self.program.tracker
            estimate = None if tracker is None else tracker.belief
        coils, patient = self.coils and self.coils.status, self._patient(time)
        return Command(wrench[0], wrench[1], inflated, patient, phase, status, estimate, coils)

    def _require_phase(self, arc_length: float) -> None:
        muscle = self.world.muscle
        if self.settings.motility != "phase-three" or muscle is None:
            return
        if muscle.phase(np.array(arc_length), 0.0) != 3:
            raise InputError(
                f"motility is phase-three, but the migrating motor complex does not pass where "
                f"the capsule is placed in {self.model.organ.name}. Allowed: fasting, steady, none."
            )

    def _require_time(self) -> None:
        if not self.settings.settle and insufflation_at(self.settings.insufflation, 0.0) != 1.0:
            raise InputError(
                "settle is 0 s, but the gut needs time to reach its first insufflation. Allowed: "
                "above 0 s, or a first factor of 1."
            )


def _silent(time: float, duration: float) -> None:
    """Report nothing."""


def _never() -> bool:
    return False
