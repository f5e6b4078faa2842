"""Stepping of worlds: one call of the core where possible, otherwise in pieces."""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps import _core
from vrcaps.world.control import GRAVITY, Control, check_steps, loads_in_patient
from vrcaps.world.lumen_dynamics import LUMEN_SUBSTEP, SUBSTEPS_PER_SWEEP
from vrcaps.world.magnetic_coupling import rows_after
from vrcaps.world.model import Contact, mean_contact
from vrcaps.world.snapshot import Snapshot

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.world.world import World

_STALE = 2e-4
"""Tolerance of the hierarchy within a step while spheres move along the wall [m]."""


@dataclass(frozen=True)
class _Trip:
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

    world: World
    dt: float
    load: Float[np.ndarray, " 10"]
    T_world_patient: Float[np.ndarray, "4 4"]
    sources: Float[np.ndarray, "k 8"]
    lumen_scale: Float[np.ndarray, " m"]
    flush: float = 0.0


def step_together(
    worlds: Sequence[World], controls: Sequence[Control], dt: float
) -> dict[int, str]:
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
    trips: dict[int, _Trip] = {}
    for k, (world, control) in enumerate(zip(worlds, controls, strict=True)):
        if k not in failures:
            world._magnetic.aim(ends[k], dt, postures[k])
            scale = world._lumen_scale_at(world.time + dt, control.insufflation)
            if world.dynamics == "quasi-static":
                _add_propulsion(world, loads[k])
            trips[k] = _Trip(world, dt, loads[k], postures[k], ends[k], scale, control.flush)
    plain = {
        k: trip for k, trip in trips.items() if trip.world._lumen is None and _num_pieces(trip) == 1
    }
    failures |= _in_one_call(plain, dt)
    failures |= _on_threads({k: trip for k, trip in trips.items() if k not in plain})
    for k, trip in trips.items():
        if k not in failures:
            _arrive(trip)
    return failures


def _arrive(trip: _Trip) -> None:
    world = trip.world
    world._time += trip.dt
    world._lumen_scale, world._T_world_patient = trip.lumen_scale, trip.T_world_patient
    world._magnetic.rows, world._state = trip.sources, None


def _in_one_call(trips: dict[int, _Trip], dt: float) -> dict[int, str]:
    """Step worlds in one call of the core; return the errors of failed worlds."""
    if not trips:
        return {}
    told = _core.step_worlds(
        [trip.world._core for trip in trips.values()],
        dt,
        np.array([trip.load for trip in trips.values()]),
        [_strides(trip, 1) for trip in trips.values()],
        [_lumen_scales(trip, 0, 1) for trip in trips.values()],
    )
    return {k: error for k, error in zip(trips, told, strict=True) if error is not None}


def _on_threads(trips: dict[int, _Trip]) -> dict[int, str]:
    """Step worlds in pieces, each on a thread; return the errors of failed worlds."""
    if len(trips) < 2:
        told = [_in_pieces(trip) for trip in trips.values()]
    else:
        with ThreadPoolExecutor(max_workers=_core.num_threads()) as threads:
            told = list(threads.map(_in_pieces, trips.values()))
    return {k: error for k, error in zip(trips, told, strict=True) if error is not None}


def _num_pieces(trip: _Trip) -> int:
    """Number of pieces of a step, so short that the force F = β (v_p − u) does not overshoot."""
    world = trip.world
    if world.dynamics == "quasi-static":
        return 1
    propulsion = None if world.muscle is None else world.muscle.motility.propulsion
    least = 1 if world._lumen is None else math.ceil(trip.dt / LUMEN_SUBSTEP * (1.0 - 1e-9))
    if propulsion is None:
        return least
    return max(least, math.ceil(propulsion.beta * trip.dt / world.body.mass))


def _strides(trip: _Trip, pieces: int) -> tuple[int, int]:
    """Number of substeps of a piece, and of steps of an elastic layer."""
    world, length = trip.world, trip.dt / pieces
    if world.dynamics == "quasi-static":
        return 1, 1
    outer = 1 if world.layer is None else world.layer.num_steps(length)
    count = outer * max(1, math.ceil(length / outer / world.substep * (1.0 - 1e-9)))
    return count, outer


def _lumen_scales(trip: _Trip, piece: int, pieces: int) -> Float[np.ndarray, "2 m"] | None:
    """Radius of the lumen at its samples before and after a piece; None if constant."""
    start, end = trip.world._lumen_scale, trip.lumen_scale
    if end is start or np.array_equal(start, end):
        return None
    return start + (end - start) * (np.array([[piece], [piece + 1]]) / pieces)


def _in_pieces(trip: _Trip) -> str | None:
    """Step a world in short pieces with propulsion and contents; return the error of a failure."""
    world, pieces, contacts = trip.world, _num_pieces(trip), []
    # Liquid levels instantly.
    lumen, liquid = world._lumen, None if world._lumen is None else world._lumen.liquid
    if lumen is not None:
        lumen.level_liquid(trip.T_world_patient, trip.lumen_scale)
        world._core.settle()  # has an effect only after `restore`
    before, (count, outer) = _save(world), _strides(trip, pieces)
    gravity = tuple(trip.load[6:9])
    if lumen is not None and trip.flush > 0.0:
        lumen.wash_off(world._core.pose, trip.flush)
    try:
        for piece in range(pieces):
            scales, length = _lumen_scales(trip, piece, pieces), trip.dt / pieces
            force = _propulsion(world, world.time + trip.dt * piece / pieces)
            wrench = tuple(trip.load[:6] + _buoyancy_wrench(world, length, force))
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


def _add_propulsion(world: World, load: Float[np.ndarray, " 10"]) -> None:
    """Add the muscle's force β (v_p − u) to a load: that on a capsule at rest, and damping."""
    if world.muscle is not None and world.muscle.motility.propulsion is not None:
        position = np.array(world._core.pose[0]) + world._center
        at_rest, moving = (
            world.muscle.propulsion(position, velocity, world.time)
            for velocity in (np.zeros(3), np.array([1.0, 0.0, 0.0]))
        )
        load[:3] += at_rest
        load[9] += at_rest[0] - moving[0]


def _propulsion(world: World, time: float) -> Float[np.ndarray, " 3"]:
    """Propulsive force of the muscle on the capsule at a time [N], in the patient frame."""
    if world.muscle is None:
        return np.zeros(3)
    position, _, velocity, _ = world._core.pose
    return world.muscle.propulsion(np.array(position) + world._center, np.array(velocity), time)


def _buoyancy_wrench(
    world: World, dt: float, force: Float[np.ndarray, " 3"]
) -> Float[np.ndarray, " 6"]:
    """Wrench of the muscle's force and of the lumen contents, in the patient frame."""
    if world._lumen is None:
        return np.array([*force, 0.0, 0.0, 0.0])
    push, torque = world._lumen.buoyancy_wrench(world._core.pose, dt, GRAVITY)
    return np.array([*(force + push), *torque])


def _step_contents(world: World, dt: float, piece: int, pieces: int) -> None:
    """Advance the lumen contents by a piece of a step; at its end the hierarchy is exact."""
    if world._lumen is not None:
        is_last = piece + 1 == pieces
        world._core.settle(0.0 if is_last else _STALE)
        since = piece % SUBSTEPS_PER_SWEEP + 1
        sweep = since * dt if is_last or since == SUBSTEPS_PER_SWEEP else 0.0
        world._lumen.step(world._core.pose, dt, GRAVITY, sweep)


def _save(world: World) -> Snapshot | Float[np.ndarray, " q"]:
    """State needed by `_undo`: the core keeps its own part, except that of an elastic layer."""
    if world.layer is not None:
        return world.snapshot()
    world._core.save()
    return np.zeros(0) if world._lumen is None else world._lumen.to_array()


def _undo(world: World, before: Snapshot | Float[np.ndarray, " q"]) -> None:
    """Restore the state before a failed step."""
    if isinstance(before, Snapshot):
        world.restore(before)
        return
    world._core.undo()
    if world._lumen is not None:
        world._lumen.restore(before, world._T_world_patient)
