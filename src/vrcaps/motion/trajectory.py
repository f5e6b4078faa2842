"""Trajectory of a capsule: poses and velocities, resampling, checks, and the start pose."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import InputError
from vrcaps.core.geometry import (
    rotation_from_vector,
    rotation_vector,
    transform_from,
    velocities_between,
)
from vrcaps.core.units import MM
from vrcaps.motion.motion import MotionState, Step, with_neighbors
from vrcaps.organ.measure import lumen_diameters, unit_question
from vrcaps.world.model import Model, State
from vrcaps.world.wall_displacement import WallDisplacement

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.magnet.sources import Source


@dataclass(frozen=True)
class Trajectory:
    """Poses and velocities of the capsule at n instants: a `Motion` known in advance.

    Attributes:
        times: Instants [s], strictly increasing.
        Ts_world_capsule: Poses of the capsule.
        linear_velocities_world: Velocities of the capsule's origin [m/s].
        angular_velocities_world: Angular velocities of the capsule [rad/s].
        notes: Notes on skipped or changed input, one line each.
        wall_displacement: Displacement of the wall that yields to the shell where the lumen is
            narrower; None keeps the wall at rest.
    """

    times: Float[np.ndarray, " n"]
    Ts_world_capsule: Float[np.ndarray, "n 4 4"]
    linear_velocities_world: Float[np.ndarray, "n 3"]
    angular_velocities_world: Float[np.ndarray, "n 3"]
    notes: tuple[str, ...] = ()
    wall_displacement: WallDisplacement | None = None

    def __len__(self) -> int:
        return len(self.times)

    def state(self, index: int) -> State:
        """State of the world at one of the instants."""
        pose, displacement = self.Ts_world_capsule[index], self.wall_displacement
        return State(
            time=float(self.times[index]),
            T_world_capsule=pose,
            linear_velocity_world=self.linear_velocities_world[index],
            angular_velocity_world=self.angular_velocities_world[index],
            vertices_world=None if displacement is None else displacement.vertices_world(pose),
        )

    def steps(
        self,
        resume: MotionState | None = None,
        *,
        progress: Callable[[float, float], None] | None = None,
        is_due: Callable[[], bool] | None = None,
    ) -> Iterator[Step]:
        """Iterate over all frames, see `Motion.steps`; there is no simulation to resume."""
        states = (self.state(index) for index in range(len(self)))
        for index, (previous, state, following) in enumerate(with_neighbors(states)):
            yield Step(index, state, previous, following)

    def checkpoint(self) -> MotionState | None:
        """None: a path known in advance restarts from its first frame."""
        return None

    def columns(self, step: Step) -> Mapping[str, float | str]:
        """No specific columns."""
        return {}

    def sources(self, step: Step) -> Sequence[Source]:
        """No external sources."""
        return ()


def trajectory_from_poses(
    times: Float[np.ndarray, " n"],
    Ts_world_capsule: Float[np.ndarray, "n 4 4"],
    *,
    notes: tuple[str, ...] = (),
) -> Trajectory:
    """Trajectory through given poses; velocities are central differences of neighbors.

    Args:
        times: Instants [s], strictly increasing, at least two.
        Ts_world_capsule: Poses of the capsule.
        notes: Notes for the trajectory.
    """
    before = np.maximum(np.arange(len(times)) - 1, 0)
    after = np.minimum(np.arange(len(times)) + 1, len(times) - 1)
    linear, angular = velocities_between(
        Ts_world_capsule[before], Ts_world_capsule[after], times[after] - times[before]
    )
    return Trajectory(times, Ts_world_capsule, linear, angular, notes)


def resample(trajectory: Trajectory, times: Float[np.ndarray, " k"]) -> Trajectory:
    """Resample a trajectory: linear in position, spherical-linear in rotation.

    Args:
        trajectory: Trajectory with at least two poses.
        times: Instants [s] within the trajectory, strictly increasing.

    Raises:
        InputError: If an instant lies outside the trajectory.
    """
    own = trajectory.times
    slack = 1e-9 * max(own[-1] - own[0], 1e-9)
    if times[0] < own[0] - slack or times[-1] > own[-1] + slack:
        raise InputError(
            f"The recorded path covers {own[0]:.6g} s to {own[-1]:.6g} s, but the frames need "
            f"{times[0]:.6g} s to {times[-1]:.6g} s. Ask for fewer frames (--frames), a "
            "higher frame rate (fps) or an earlier start (motion.start)."
        )
    left = np.clip(np.searchsorted(own, times, side="right") - 1, 0, len(own) - 2)
    weight = ((times - own[left]) / (own[left + 1] - own[left]))[:, None]
    poses = trajectory.Ts_world_capsule
    positions = (1.0 - weight) * poses[left, :3, 3] + weight * poses[left + 1, :3, 3]
    turn = rotation_vector(poses[left, :3, :3], poses[left + 1, :3, :3])
    rotations = rotation_from_vector(weight * turn) @ poses[left, :3, :3]
    Ts_world_capsule = transform_from(rotations, positions)
    if len(times) > 1:
        return trajectory_from_poses(times, Ts_world_capsule, notes=trajectory.notes)
    span = own[left + 1] - own[left]
    linear, angular = velocities_between(poses[left], poses[left + 1], span)
    return Trajectory(times, Ts_world_capsule, linear, angular, trajectory.notes)


def fit_text(model: Model) -> str:
    """Sentence on the widths of lumen and capsule, and on the unit of the organ's file."""
    organ = model.organ
    least, median, most = lumen_diameters(organ.centerline)
    unit = organ.metadata.get("unit")
    question = unit_question(unit, median) if isinstance(unit, str) else ""
    return (
        f"the lumen is {least / MM:.1f} to {most / MM:.1f} mm wide, the capsule "
        f"{2.0 * model.device.radius / MM:.1f} mm thick.{question}"
    )


_SPACING = 2.0 * MM
"""Distance between the positions that are tried."""

_CLEARANCE = 0.5
"""Minimum distance of the capsule's axis from the wall, as a fraction of its radius."""


def start_pose(
    model: Model, start: float, angle: float
) -> tuple[Float[np.ndarray, "4 4"], float, tuple[str, ...]]:
    """Pose where the capsule fits, its arc length [m], and notes on changes.

    Args:
        model: The lumen and the capsule.
        start: Desired position as a fraction of the centerline; moved towards the far end.
        angle: Angle about the x axis of the centerline's frame [rad].

    Raises:
        InputError: If it does not fit anywhere.
    """
    line = model.organ.centerline
    wanted = start * line.length
    # Towards the far end: a capsule that does not fit at one end fits further in.
    end = line.length if start <= 0.5 else 0.0
    arc_lengths = np.linspace(wanted, end, max(2, math.ceil(abs(end - wanted) / _SPACING) + 1))
    poses = model.centerline_poses(arc_lengths, angle=angle)
    clearance = model.clearance(poses).min(axis=1)
    fitting = np.flatnonzero(clearance > _CLEARANCE * model.device.radius)
    if len(fitting) == 0:
        raise InputError(
            f"{model.device.name} in {model.organ.name}: the capsule fits nowhere beyond start "
            f"{start:g}: {fit_text(model)} Change start, inflate the gut, or use a smaller "
            "capsule."
        )
    arc_length = float(arc_lengths[fitting[0]])
    moved = abs(arc_length - wanted)
    note = f"Set the capsule {moved / MM:.1f} mm further along, where it fits."
    return poses[fitting[0]], arc_length, (note,) if moved > 0.0 else ()
