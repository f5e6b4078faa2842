"""Batch of worlds: many worlds stepped and read together, by one call of the core if possible."""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING, Generic, TypeVar

import numpy as np

from vrcaps import _core
from vrcaps.core.errors import InputError, require
from vrcaps.core.geometry import rotate_vectors
from vrcaps.world.control import GRAVITY, Control, check_steps, loads_in_patient
from vrcaps.world.lumen_dynamics import LUMEN_SUBSTEP, SUBSTEPS_PER_SWEEP
from vrcaps.world.magnetic_coupling import rows_after
from vrcaps.world.mechanics import Mechanics
from vrcaps.world.model import Contact, mean_contact
from vrcaps.world.snapshot import Snapshot

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

Member = TypeVar("Member", bound=Mechanics)


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


class WorldBatch(Generic[Member]):
    """Several worlds, stepped and read in one call each, on all processors.

    Each world evolves byte for byte as if it were stepped alone. `RAYON_NUM_THREADS` sets the
    number of threads. Methods take the indices of the worlds that they concern; None is all.

    Example:
        >>> batch = WorldBatch([World(model, seed=k) for k in range(16)])
        >>> batch.step([Control()] * 16, dt=0.01)
        >>> batch.state().Ts_world_capsule[:, :3, 3]

    Attributes:
        worlds: The worlds.
    """

    def __init__(self, worlds: Sequence[Member] = ()) -> None:
        """Collect worlds.

        Raises:
            InputError: If a world is given twice.
        """
        if len({id(world) for world in worlds}) < len(worlds):
            raise InputError("A world is given twice. Allowed: each world once.")
        self.worlds = list(worlds)

    def at(self, indices: Sequence[int] | np.ndarray | None) -> list[Member]:
        """Return the worlds of some indices."""
        return self.worlds if indices is None else [self.worlds[index] for index in indices]

    def step(self, controls: Sequence[Control], dt: float) -> None:
        """Advance each world by a time `dt` [s] as `World.step` does.

        Raises:
            InputError: If the numbers of controls and worlds differ, or a world cannot step. Worlds
                that cannot step are unchanged, all others have stepped.
        """
        failures = self.try_step(controls, dt)
        if failures:
            reasons = " ".join(f"World {k}: {failure}" for k, failure in sorted(failures.items()))
            others = len(self.worlds) - len(failures)
            raise InputError(f"{reasons} {others} other worlds have stepped.")

    def try_step(
        self,
        controls: Sequence[Control],
        dt: float,
        indices: Sequence[int] | np.ndarray | None = None,
    ) -> dict[int, str]:
        """Advance some worlds by a time `dt` [s]; return the errors of failed worlds, by index.

        Worlds that cannot step are unchanged.

        Args:
            controls: Commands of each of these worlds.
            dt: Duration [s].
            indices: Indices of the worlds.

        Raises:
            InputError: If the numbers of controls and worlds differ, or the step is too long.
        """
        worlds = self.at(indices)
        require(len(controls) == len(worlds), "Number of controls", len(controls), f"{len(worlds)}")
        failures = advance(worlds, controls, dt)
        if indices is None:
            return failures
        return {int(indices[row]): failure for row, failure in failures.items()}

    def state(self, indices: Sequence[int] | np.ndarray | None = None) -> BatchState:
        """Read current poses, velocities and contact, as each world reports them."""
        worlds = self.at(indices)
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

    def are_inside(
        self, indices: Sequence[int] | np.ndarray | None = None
    ) -> Bool[np.ndarray, " n"]:
        """Check for each world that the capsule's axis is in the lumen, see `World.is_inside`."""
        return np.array(_core.worlds_inside([world._core for world in self.at(indices)]), bool)

    def walls(self, indices: Sequence[int] | np.ndarray | None = None) -> list[_core.Wall]:
        """Return the current wall of each world, see `World.wall`; the next step moves it."""
        worlds = self.at(indices)
        _core.settle_worlds([world._core for world in worlds])
        return [world._wall for world in worlds]


_STALE = 2e-4
"""Tolerance of the hierarchy within a step while spheres move along the wall [m]."""


@dataclass(frozen=True)
class _WorldStep:
    """One step of one world.

    Attributes:
        world: The world.
        dt: Duration [s].
        load: Commanded force [N] and torque [N·m], gravity [m/s²], in the patient frame, and
            damping [N·s/m].
        T_world_patient: Posture of the patient at its end.
        sources: Poses of the sources at its end.
        lumen_scale: Radius of the lumen at its samples at its end.
        flush: See `Control.flush`.
    """

    world: Mechanics
    dt: float
    load: Float[np.ndarray, " 10"]
    T_world_patient: Float[np.ndarray, "4 4"]
    sources: Float[np.ndarray, "k 8"]
    lumen_scale: Float[np.ndarray, " m"]
    flush: float = 0.0


def advance(worlds: Sequence[Mechanics], controls: Sequence[Control], dt: float) -> dict[int, str]:
    """Advance each world by `dt` [s]; return the errors of failed worlds, by index.

    Failed worlds are unchanged.

    Raises:
        InputError: If the step is too long.
    """
    failures = check_steps(controls, dt)
    ends, more = rows_after([world._magnetic for world in worlds], controls)
    failures = more | failures
    postures = [
        world._T_world_patient
        if control.T_world_patient is None
        else np.asarray(control.T_world_patient, float)
        for world, control in zip(worlds, controls, strict=True)
    ]
    loads = loads_in_patient(controls, np.array(postures, float).reshape(-1, 4, 4))
    loads = np.hstack([loads, np.zeros((len(loads), 1))])
    steps: dict[int, _WorldStep] = {}
    for k, (world, control) in enumerate(zip(worlds, controls, strict=True)):
        if k not in failures:
            world._magnetic.aim(ends[k], dt, postures[k])
            scale = world._lumen_scale_at(world.time + dt, control.insufflation)
            if world.dynamics == "quasi-static":
                _add_propulsion(world, loads[k])
            steps[k] = _WorldStep(world, dt, loads[k], postures[k], ends[k], scale, control.flush)
    plain = {
        k: step for k, step in steps.items() if step.world._lumen is None and _num_pieces(step) == 1
    }
    failures |= _in_one_call(plain, dt)
    failures |= _on_threads({k: step for k, step in steps.items() if k not in plain})
    for k, step in steps.items():
        if k not in failures:
            _arrive(step)
    return failures


def _arrive(step: _WorldStep) -> None:
    world = step.world
    world._time += step.dt
    world._lumen_scale, world._T_world_patient = step.lumen_scale, step.T_world_patient
    world._magnetic.rows, world._state = step.sources, None


def _in_one_call(steps: dict[int, _WorldStep], dt: float) -> dict[int, str]:
    """Step worlds in one call of the core; return the errors of failed worlds."""
    if not steps:
        return {}
    errors = _core.step_worlds(
        [step.world._core for step in steps.values()],
        dt,
        np.array([step.load for step in steps.values()]),
        [_strides(step, 1) for step in steps.values()],
        [_lumen_scales(step, 0, 1) for step in steps.values()],
    )
    return {k: error for k, error in zip(steps, errors, strict=True) if error is not None}


def _on_threads(steps: dict[int, _WorldStep]) -> dict[int, str]:
    """Step worlds in pieces, each on a thread; return the errors of failed worlds."""
    if len(steps) < 2:
        errors = [_in_pieces(step) for step in steps.values()]
    else:
        with ThreadPoolExecutor(max_workers=_core.num_threads()) as threads:
            errors = list(threads.map(_in_pieces, steps.values()))
    return {k: error for k, error in zip(steps, errors, strict=True) if error is not None}


def _num_pieces(step: _WorldStep) -> int:
    """Number of pieces of a step, so short that the force F = β (v_p − u) does not overshoot."""
    world = step.world
    if world.dynamics == "quasi-static":
        return 1
    propulsion = None if world.muscle is None else world.muscle.motility.propulsion
    least = 1 if world._lumen is None else math.ceil(step.dt / LUMEN_SUBSTEP * (1.0 - 1e-9))
    if propulsion is None:
        return least
    return max(least, math.ceil(propulsion.beta * step.dt / world.body.mass))


def _strides(step: _WorldStep, pieces: int) -> tuple[int, int]:
    """Number of substeps of a piece, and of steps of an elastic layer."""
    world, length = step.world, step.dt / pieces
    if world.dynamics == "quasi-static":
        return 1, 1
    outer = 1 if world.layer is None else world.layer.num_steps(length)
    count = outer * max(1, math.ceil(length / outer / world.substep * (1.0 - 1e-9)))
    return count, outer


def _lumen_scales(step: _WorldStep, piece: int, pieces: int) -> Float[np.ndarray, "2 m"] | None:
    """Radius of the lumen at its samples before and after a piece; None if constant."""
    start, end = step.world._lumen_scale, step.lumen_scale
    if end is start or np.array_equal(start, end):
        return None
    return start + (end - start) * (np.array([[piece], [piece + 1]]) / pieces)


def _in_pieces(step: _WorldStep) -> str | None:
    """Step a world in short pieces with propulsion and contents; return the error of a failure."""
    world, pieces, contacts = step.world, _num_pieces(step), []
    # Liquid levels instantly.
    lumen, liquid = world._lumen, None if world._lumen is None else world._lumen.liquid
    if lumen is not None:
        lumen.level_liquid(step.T_world_patient, step.lumen_scale)
        world._core.settle()  # has an effect only after `restore`
    before, (count, outer) = _save(world), _strides(step, pieces)
    gravity = tuple(step.load[6:9])
    if lumen is not None and step.flush > 0.0:
        lumen.wash_off(world._core.pose, step.flush)
    try:
        for piece in range(pieces):
            scales, length = _lumen_scales(step, piece, pieces), step.dt / pieces
            force = _propulsion(world, world.time + step.dt * piece / pieces)
            wrench = tuple(step.load[:6] + _buoyancy_wrench(world, length, force))
            world._core.step(length / count, count, wrench, gravity, scales, outer)
            force, torque, *rest = world._core.contact()
            contacts.append(Contact(np.array(force), np.array(torque), *rest))
            _step_contents(world, length, piece, pieces)
    except ValueError as error:
        _undo(world, before)
        if lumen is not None and liquid is not None:
            lumen.set_liquid(liquid, world._T_world_patient)
        return str(error)
    means = vars(mean_contact(contacts)).values()
    world._core.set_contact(tuple(np.concatenate([np.ravel(part) for part in means])))
    return None


def _add_propulsion(world: Mechanics, load: Float[np.ndarray, " 10"]) -> None:
    """Add the muscle's force β (v_p − u) to a load: that on a capsule at rest, and damping."""
    if world.muscle is not None and world.muscle.motility.propulsion is not None:
        position = np.array(world._core.pose[0]) + world._center
        at_rest, moving = (
            world.muscle.propulsion(position, velocity, world.time)
            for velocity in (np.zeros(3), np.array([1.0, 0.0, 0.0]))
        )
        load[:3] += at_rest
        load[9] += at_rest[0] - moving[0]


def _propulsion(world: Mechanics, time: float) -> Float[np.ndarray, " 3"]:
    """Propulsive force of the muscle on the capsule at a time [N], in the patient frame."""
    if world.muscle is None:
        return np.zeros(3)
    position, _, velocity, _ = world._core.pose
    return world.muscle.propulsion(np.array(position) + world._center, np.array(velocity), time)


def _buoyancy_wrench(
    world: Mechanics, dt: float, force: Float[np.ndarray, " 3"]
) -> Float[np.ndarray, " 6"]:
    """Wrench of the muscle's force and of the lumen contents, in the patient frame."""
    if world._lumen is None:
        return np.array([*force, 0.0, 0.0, 0.0])
    push, torque = world._lumen.buoyancy_wrench(world._core.pose, dt, GRAVITY)
    return np.array([*(force + push), *torque])


def _step_contents(world: Mechanics, dt: float, piece: int, pieces: int) -> None:
    """Advance the lumen contents by a piece of a step; at its end the hierarchy is exact."""
    if world._lumen is not None:
        is_last = piece + 1 == pieces
        world._core.settle(0.0 if is_last else _STALE)
        since = piece % SUBSTEPS_PER_SWEEP + 1
        sweep = since * dt if is_last or since == SUBSTEPS_PER_SWEEP else 0.0
        world._lumen.step(world._core.pose, dt, GRAVITY, sweep)


def _save(world: Mechanics) -> Snapshot | Float[np.ndarray, " q"]:
    """State needed by `_undo`: the core keeps its own part, except that of an elastic layer."""
    if world.layer is not None:
        return world.snapshot()
    world._core.save()
    return np.zeros(0) if world._lumen is None else world._lumen.to_array()


def _undo(world: Mechanics, before: Snapshot | Float[np.ndarray, " q"]) -> None:
    """Restore the state before a failed step."""
    if isinstance(before, Snapshot):
        world.restore(before)
        return
    world._core.undo()
    if world._lumen is not None:
        world._lumen.restore(before, world._T_world_patient)
