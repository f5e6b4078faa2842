"""Several worlds, stepped and read in one call."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps import _core
from vrcaps.core.errors import InputError, require
from vrcaps.core.transforms import rotate_vectors
from vrcaps.world.control import Control
from vrcaps.world.stepping import step_together
from vrcaps.world.world import World

if TYPE_CHECKING:
    from jaxtyping import Bool, Float


def step_worlds(worlds: Sequence[World], controls: Sequence[Control], dt: float) -> None:
    """Advance each world by a time `dt` [s] as `World.step` does, on all processors.

    Each world gets the same bytes as alone. `RAYON_NUM_THREADS` sets the number of threads.

    Raises:
        InputError: If the numbers of controls and worlds differ, a world is given twice, or a world
            cannot step. Worlds that cannot step are unchanged, all others have stepped.
    """
    require(len(controls) == len(worlds), "Number of controls", len(controls), f"{len(worlds)}")
    if len({id(world) for world in worlds}) < len(worlds):
        raise InputError("A world is given twice. Allowed: each world once.")
    failures = step_together(worlds, controls, dt)
    if failures:
        told = " ".join(f"World {k}: {failure}" for k, failure in sorted(failures.items()))
        raise InputError(f"{told} {len(worlds) - len(failures)} other worlds have stepped.")


@dataclass(frozen=True)
class BatchState:
    """Variable state of several worlds, one row each, in the world frame.

    The contact is that of the last step, see `Contact`.

    Attributes:
        time: Time of each world [s].
        Ts_world_capsule: Poses of the capsules.
        linear_velocity_world: Velocities of the capsules' origins [m/s].
        angular_velocity_world: Angular velocities [rad/s].
        contact_force_world: Mean force of the wall on each capsule [N].
        contact_torque_world: Mean torque of the wall about each center of mass [N·m].
        normal_force_total: Mean sum of the magnitudes of all normal forces [N].
        friction_work: Energy lost to friction and drag in the step [J].
        energy: Energy stored in the indented wall [J].
        area: Contact area [m²].
        depth: Maximum indentation [m].
    """

    time: Float[np.ndarray, " n"]
    Ts_world_capsule: Float[np.ndarray, "n 4 4"]
    linear_velocity_world: Float[np.ndarray, "n 3"]
    angular_velocity_world: Float[np.ndarray, "n 3"]
    contact_force_world: Float[np.ndarray, "n 3"]
    contact_torque_world: Float[np.ndarray, "n 3"]
    normal_force_total: Float[np.ndarray, " n"]
    friction_work: Float[np.ndarray, " n"]
    energy: Float[np.ndarray, " n"]
    area: Float[np.ndarray, " n"]
    depth: Float[np.ndarray, " n"]


def batch_state(worlds: Sequence[World]) -> BatchState:
    """Current poses, velocities and contact of several worlds, as each of them reports."""
    Ts_world_patient = np.array([world._T_world_patient for world in worlds], float)
    Ts_world_patient = Ts_world_patient.reshape(-1, 4, 4)
    poses, motions, wrenches, rest = _core.world_states(
        [world._core for world in worlds], Ts_world_patient.reshape(-1, 16)
    )
    velocity = rotate_vectors(Ts_world_patient, motions.reshape(-1, 2, 3))
    wrench = rotate_vectors(Ts_world_patient, wrenches.reshape(-1, 2, 3))
    return BatchState(
        np.array([world.time for world in worlds]),
        poses.reshape(-1, 4, 4),
        velocity[:, 0],
        velocity[:, 1],
        wrench[:, 0],
        wrench[:, 1],
        *np.ascontiguousarray(rest.T),
    )


def are_inside(worlds: Sequence[World]) -> Bool[np.ndarray, " n"]:
    """Check for each world that the capsule's axis is in the lumen, see `World.is_inside`."""
    return np.array(_core.worlds_inside([world._core for world in worlds]), bool)


def walls_of(worlds: Sequence[World]) -> list[_core.Wall]:
    """Current wall of each world, see `World.wall`; the next step of a world moves it."""
    _core.settle_worlds([world._core for world in worlds])
    return [world._wall for world in worlds]
