"""A run that is simulated: the world is stepped from frame to frame, one state at a time."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.actuation.steering_program import SteeringProgram
from vrcaps.errors import InputError
from vrcaps.file_ref import path_of
from vrcaps.motion.dynamics import Dynamics, make_tissue
from vrcaps.motion.run import Conditions, Instant
from vrcaps.organ.surface import OrganSurface
from vrcaps.transforms import (
    invert,
    rotate_vectors,
    rotation_from_vector,
    transform_from,
    transform_points,
)
from vrcaps.units import CM, MM
from vrcaps.world.clearance import capsule_clearance
from vrcaps.world.control import Control
from vrcaps.world.model import Contact, Coupling, Model, State
from vrcaps.world.schedule import in_world, insufflation_at, patient_at, read_wrenches, wrench_at
from vrcaps.world.snapshot import Snapshot
from vrcaps.world.world import World

if TYPE_CHECKING:
    from jaxtyping import Float

_SPACING = 2.0 * MM
"""Of the places where a capsule is tried that does not fit at the start."""

_FREE = 0.5
"""Share of the capsule's radius that its axis keeps from the wall where it is set."""

_PASSED = 5.0 * CM
"""How far the front of phase III is beyond the capsule in the first frame: less than the 9 cm that
phase III covers where its front is slowest, the terminal ileum, at 0.9 cm/min for 10 min."""

_NEARBY = 3.0 * CM
"""How far along the gut the capsule's place is sought from where it was a step before."""


class Rollout:
    """A run of a `World`. Its frames are made anew, to the same bytes, at every walk through."""

    def __init__(
        self,
        model: Model,
        settings: Dynamics,
        *,
        frames: int,
        fps: float,
        seed: int,
        shown: OrganSurface | None = None,
    ) -> None:
        """Sets the capsule into the organ.

        Args:
            model: The lumen and the capsule.
            settings: How it moves.
            frames: Number of frames, at least 1.
            fps: Frames per second.
            seed: Of the patient's muscle, 0 or more.
            shown: Another organ with the same triangles, such as the clean twin: its wall is
                moved like the model's and is what states hold.

        Raises:
            InputError: If the capsule fits nowhere, a setting is impossible, or the other organ
                has other triangles.
            UnknownNameError: If the tissue has no muscle for a segment of the wall.
        """
        self.model, self.settings = model, settings
        self.frames, self.fps = frames, fps
        file = settings.wrench_file
        self._wrenches = settings.wrenches if file is None else read_wrenches(path_of(file))
        self._line = model.organ.centerline
        self._offset = None if shown is None else _offset(model.organ, shown)
        pose, arc_length, self.notes = _start(model, settings)
        self.program = None
        if settings.magnet is not None:
            self.program = SteeringProgram(model, settings.magnet, pose, arc_length)
            self.notes += self.program.notes
        self.world = World(
            model,
            make_tissue(settings, front=min(arc_length + _PASSED, self._line.length)),
            State(-settings.settle, pose),
            substep=settings.substep,
            seed=seed,
            sources=() if self.program is None else self.program.controller.sources,
        )
        self._require_phase(arc_length)
        self._require_time()
        self._arc_length = arc_length
        self._begin = self.snapshot()
        self.on_step: Callable[[float, float], None] = _silent

    def __len__(self) -> int:
        return self.frames

    @property
    def duration(self) -> float:
        """Simulated time, with settling [s]."""
        return self.settings.settle + (self.frames - 1) / self.fps

    def snapshot(self) -> tuple[float, Snapshot]:
        """What `instants` needs to go on from the frame it gave last."""
        controller = np.zeros(0) if self.program is None else self.program.to_array()
        return self._arc_length, replace(self.world.snapshot(), controller=controller)

    def instants(
        self, frame: int = 0, snapshot: tuple[float, Snapshot] | None = None
    ) -> Iterator[Instant]:
        """Frames from one on.

        Args:
            frame: The first to give.
            snapshot: Taken when that frame was given; None, for frame 0 only, begins anew.

        Raises:
            InputError: If the world cannot be stepped; says at which time.
        """
        self._arc_length, start = snapshot or self._begin
        self.world.restore(start)
        if self.program is not None:
            self.program.restore(start.controller)
        if snapshot is None:
            yield self._advanced(-self.settings.settle, 0.0)
        else:
            conditions = self._conditions(frame / self.fps, np.zeros((2, 3)))
            yield self._instant(self.world.state, frame / self.fps, conditions)
        for index in range(frame + 1, self.frames):
            yield self._advanced((index - 1) / self.fps, index / self.fps)

    def _advanced(self, begin: float, end: float) -> Instant:
        """The world after steps from one time to another [s]."""
        magnet = self.settings.magnet
        step = self.settings.step if magnet is None else min(self.settings.step, magnet.period)
        count = math.ceil((end - begin) / step * (1.0 - 1e-9))
        contacts, couplings, wrenches = [], [], np.zeros((max(count, 1), 2, 3))
        for index in range(count):
            times = [begin + (end - begin) * (index + k) / count for k in (0, 1)]
            wrenches[index] = self._wrench(times[0]) if begin >= 0.0 else 0.0
            control = replace(
                self._steered(times),
                force_world=wrenches[index, 0],
                torque_world=wrenches[index, 1],
                T_world_patient=self._patient(times[1]),
                insufflation=self._insufflation(times[1]),
            )
            try:
                self.world.step(control, times[1] - times[0])
            except InputError as error:
                raise InputError(f"At {times[0]:.3f} s of the simulation: {error}") from error
            contacts.append(self.world.contact)
            couplings.append(self.world.coupling)
            self._follow()
            self.on_step(times[1] + self.settings.settle, self.duration)
        state = self.world.state
        if contacts:
            coupling = mean_coupling(couplings)
            state = replace(state, contact=over_all(contacts), coupling=coupling)
        return self._instant(state, end, self._conditions(end, wrenches.mean(axis=0)))

    def _steered(self, times: list[float]) -> Control:
        """Command of the magnet between two times."""
        if self.program is None:
            return Control()
        begin, end = times
        return self.program.control(self.world, begin, end - begin, self._patient(end))

    def _instant(self, state: State, time: float, conditions: Conditions) -> Instant:
        """A frame's instant, at exactly its time, with the wall that is shown."""
        vertices = state.vertices_world
        if vertices is not None and self._offset is not None:
            vertices = vertices + rotate_vectors(conditions.T_world_patient, self._offset)
        return Instant(replace(state, time=time, vertices_world=vertices), conditions)

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
        """How the patient lies; the model's own matrix where nobody turns."""
        if not self.settings.posture_changes:
            return self.model.T_world_patient
        return patient_at(self.model.T_world_patient, self.settings.posture_changes, time)

    def _insufflation(self, time: float) -> float:
        """Factor on the lumen's radius; before the first frame on the way to its first value."""
        if time >= 0.0 or not self.settings.settle:
            return insufflation_at(self.settings.insufflation, max(time, 0.0))
        share = 1.0 + time / self.settings.settle
        first = insufflation_at(self.settings.insufflation, 0.0)
        return 1.0 + (first - 1.0) * share**2 * (3.0 - 2.0 * share)

    def _follow(self) -> None:
        """Brings the capsule's place along the gut up to date, near where it was."""
        to_patient = invert(self._patient(self.world.time))
        position = transform_points(to_patient, self.world.T_world_capsule[:3, 3])
        s = self._line.arc_length
        low, high = np.searchsorted(s, [self._arc_length - _NEARBY, self._arc_length + _NEARBY])
        near = self._line.points[low:high]
        if len(near):
            self._arc_length = float(s[low + np.argmin(((near - position) ** 2).sum(axis=1))])

    def _conditions(self, time: float, wrench: Float[np.ndarray, "2 3"]) -> Conditions:
        muscle = self.world.muscle
        phase = 0 if muscle is None else int(muscle.phase(np.array(self._arc_length), time))
        inflated = self._insufflation(time)
        status = None if self.program is None else self.program.controller.status
        return Conditions(wrench[0], wrench[1], inflated, self._patient(time), phase, status)

    def _require_phase(self, arc_length: float) -> None:
        muscle = self.world.muscle
        if self.settings.motility != "phase-three" or muscle is None:
            return
        if muscle.phase(np.array(arc_length), 0.0) != 3:
            raise InputError(
                f"motility is phase-three, but the migrating motor complex does not pass where "
                f"the capsule is set in {self.model.organ.name}. Choose fasting, steady or none."
            )

    def _require_time(self) -> None:
        if not self.settings.settle and insufflation_at(self.settings.insufflation, 0.0) != 1.0:
            raise InputError(
                "settle is 0 s, but the gut needs time to take on its first insufflation. Allowed: "
                "above 0 s, or a first factor of 1."
            )


def _offset(organ: OrganSurface, shown: OrganSurface) -> Float[np.ndarray, "n 3"]:
    """From each vertex of an organ to that of another with the same triangles [m].

    Raises:
        InputError: If the triangles differ.
    """
    if not np.array_equal(organ.faces, shown.faces):
        raise InputError(
            f"{organ.name} and its clean twin have different triangles, so the one's moving wall "
            "cannot be shown on the other. Record the twin with another motion."
        )
    return shown.vertices - organ.vertices


def _silent(time: float, duration: float) -> None:
    """Report nothing."""


def over_all(contacts: list[Contact]) -> Contact:
    """Contact over equal steps: means of forces, sum of work, the last step's patch."""

    def mean(name: str) -> Float[np.ndarray, "*n"]:
        return np.mean([getattr(contact, name) for contact in contacts], axis=0)

    return replace(
        contacts[-1],
        force_world=mean("force_world"),
        torque_world=mean("torque_world"),
        normal_force_total=float(mean("normal_force_total")),
        friction_work=float(np.sum([contact.friction_work for contact in contacts])),
    )


def mean_coupling(couplings: list[Coupling | None]) -> Coupling | None:
    """Coupling over equal steps: mean force and torque, the rest of the last step."""
    last, known = couplings[-1], [c for c in couplings if c is not None]
    if last is None:
        return None
    force = np.mean([coupling.force_world for coupling in known], axis=0)
    torque = np.mean([coupling.torque_world for coupling in known], axis=0)
    is_exact = all(coupling.is_exact for coupling in known)
    return replace(last, force_world=force, torque_world=torque, is_exact=is_exact)


def _start(
    model: Model, settings: Dynamics
) -> tuple[Float[np.ndarray, "4 4"], float, tuple[str, ...]]:
    """Pose of the capsule at rest where it fits, its arc length [m], and what was changed.

    Raises:
        InputError: If it fits nowhere.
    """
    line = model.organ.centerline
    asked = settings.start * line.length
    # Towards the far end: a capsule that does not fit at an end fits further in.
    end = line.length if settings.start <= 0.5 else 0.0
    places = np.linspace(asked, end, max(2, math.ceil(abs(end - asked) / _SPACING) + 1))
    nearest = np.abs(line.arc_length[:, None] - places).argmin(axis=0)
    points = np.stack([np.interp(places, line.arc_length, axis) for axis in line.points.T], -1)
    tilt = rotation_from_vector(np.array([settings.angle, 0.0, 0.0]))
    poses = model.T_world_patient @ transform_from(line.frames[nearest] @ tilt, points)
    free = capsule_clearance(model, poses).min(axis=1)
    fitting = np.flatnonzero(free > _FREE * model.device.radius)
    if len(fitting) == 0:
        raise InputError(
            f"{model.device.name} in {model.organ.name}: the capsule fits nowhere from start "
            f"{settings.start:g} on. Check the organ's unit, start elsewhere, inflate the gut, or "
            "take a smaller capsule."
        )
    place = float(places[fitting[0]])
    moved = abs(place - asked)
    note = f"Set the capsule {moved / MM:.1f} mm further along, where it fits."
    return poses[fitting[0]], place, (note,) if moved > 0.0 else ()
