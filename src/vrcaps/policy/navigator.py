"""Navigator: a magnet leads the capsule along the lower wall of the gut to its goal.

Each capsule follows a path along the wall, see `centerline_wall_path`. In every control period the
magnet is asked to be where the capsule's front is turned to the direction t towards the place on
the path a little ahead, and the capsule feels the force

    F = (m g − R) up + (k_p e + k_i ∫e dt) t,    e = v* − v·t

with the weight R that rests on the wall and the speed v* along the path. F changes evenly, so that
the magnet can follow. Where a fold stops the capsule, the integral grows; where that is not enough,
the capsule hops: for a while it is lifted off the wall with its nose up, higher each time.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.actuation.magnet_pose_solver import MagnetPoseSolver, Workspace, WrenchTarget
from vrcaps.actuation.vectors import clamp_norm
from vrcaps.actuation.wall_path import WallPath, centerline_wall_path
from vrcaps.env.actuation.magnet import MagnetActuation
from vrcaps.errors import InputError
from vrcaps.geometry import unit
from vrcaps.magnet.field import SourceSet
from vrcaps.magnet.presets import read_magnet
from vrcaps.policy.policy import Requirements
from vrcaps.policy.servo import heading_error, magnet_action
from vrcaps.transforms import rotation_from_vector
from vrcaps.units import CM, MM
from vrcaps.world.control import GRAVITY

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.env.simulation import Simulation
    from vrcaps.env.vector_env import CapsuleVectorEnv

_SPEED = 2.0 * CM
"""Speed v* along the path [m/s]."""

_AHEAD, _NEARBY = 20.0 * MM, 40.0 * MM
"""How far ahead on the path the capsule is led, and how far around it is sought there [m]."""

_REST = 0.04
"""Weight R that rests on the wall [N]."""

_PROPORTIONAL, _INTEGRAL = 0.3, 0.8
"""Gains k_p [N·s/m] and k_i [N/m]."""

_PULL = (-0.04, 0.07)
"""Least and largest pull along the way [N]."""

_HEIGHT, _HEIGHT_GAIN, _SINK = 8.0 * MM, 3.0, 0.06
"""Height above the path from which it is supported less [m], how much so [N/m], at most [N]."""

_SMOOTHING = 0.5
"""Time over which velocity is averaged [s]."""

_FORCE_RATE, _TURN_RATE, _LEAD = 0.08, 0.6, 0.6
"""How fast force [N/s] and heading [rad/s] change; the heading's largest angle ahead [rad]."""

_PATIENCE, _GAIN = 4.0, 5.0 * MM
"""Time without this gain of way after which the capsule hops [s], [m]."""

_HOP, _HOP_PULL, _HOP_PITCH = 3.0, 0.05, 0.5
"""Length of a hop [s], pull during it [N], upward part of its heading."""

_HOP_LIFT, _HIGHEST_HOP = 0.02, 5
"""Lift beyond the weight in the first hop [N]; hop after which it grows no more. Every third hop
begins backward."""

_MOTION_WEIGHT = 1.0
"""Weight of moving the magnet by its distance, beside force errors of 10 mN."""

_ITERATIONS = 10


class NavigatorPolicy:
    """Leads capsules to the goal of `navigate`; without one, to the farther end of the gut."""

    requires = Requirements(
        settings={"task": "navigate", "control_period": 0.05}, actuations=("magnet",)
    )

    def __init__(self) -> None:
        self._guides: dict[int, Guide] = {}

    def reset(self, numbers: np.ndarray, seeds: Sequence[int]) -> None:
        """Forget the paths of some worlds."""
        for number in np.asarray(numbers).tolist():
            self._guides.pop(number, None)

    def act(self, observations: dict[str, np.ndarray], env: CapsuleVectorEnv) -> np.ndarray:
        """The magnets' twists for the next control period."""
        simulation = env.episode.simulation
        for index in range(env.num_envs):
            if index not in self._guides:
                self._guides[index] = Guide(simulation, index)
        twists = [self._guides[index].twist(simulation) for index in range(env.num_envs)]
        return np.array(twists, np.float32)


class Guide:
    """Leads the capsule of one world; holds its path and the controller's state.

    Attributes:
        path: Along the wall.
        place: Where the capsule is along it [m].
    """

    def __init__(self, simulation: Simulation, index: int) -> None:
        """Plans the path.

        Args:
            simulation: Where an episode has begun.
            index: The world.
        """
        model, memory = simulation.patient(index).model, simulation.memory
        self._actuation = _magnet_of(simulation)
        magnet = read_magnet(self._actuation.magnet)
        low, high = memory["magnet/box"][index].tolist()
        workspace = Workspace(tuple(low), tuple(high), 0.5 * magnet.diameter + 3.0 * CM)
        self._solver = MagnetPoseSolver(SourceSet([magnet]), model.device.magnets, workspace)
        self._index, self._weight = index, model.device.mass * GRAVITY
        self.path, self.place = _path(simulation, index), 0.0
        T = simulation.T_world_capsule[index]
        self._position, self._velocity = T[:3, 3].copy(), np.zeros(3)
        self._heading = T[:3, :3].copy()
        self._integral, self._force = 0.0, np.array([0.0, 0.0, self._weight - _REST])
        self._best, self._since, self._hops = 0.0, 0.0, 0

    def twist(self, simulation: Simulation) -> Float[np.ndarray, " 6"]:
        """The magnet's action for the next control period."""
        dt, T = simulation.settings.control_period, simulation.T_world_capsule[self._index]
        self._velocity += min(dt / _SMOOTHING, 1.0) * (
            (T[:3, 3] - self._position) / dt - self._velocity
        )
        self._position = T[:3, 3].copy()
        here, ahead = self._places(self._position)
        way = unit(ahead - self._position)
        pull, lift, pitch = self._pull(way, dt, float(simulation.time[self._index]))
        sink = min(_HEIGHT_GAIN * max(self._position[2] - here[2] - _HEIGHT, 0.0), _SINK)
        wanted = pull * way + np.array([0.0, 0.0, self._weight + lift - sink])
        self._force = self._force + clamp_norm(wanted - self._force, _FORCE_RATE * dt)
        T_led = T.copy()
        T_led[:3, :3] = self._led(T[:3, :3], unit(way + np.array([0.0, 0.0, pitch])), dt)
        return self._towards(simulation, T_led, dt)

    def _places(
        self, position: Float[np.ndarray, " 3"]
    ) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"]]:
        """Positions on the path where the capsule is and a little ahead [m]."""
        path = self.path
        away = np.abs(path.arc_length - self.place)
        squares = np.sum((path.positions - position) ** 2, axis=1)
        here = int(np.where(away < _NEARBY, squares, np.inf).argmin())
        self.place = float(path.arc_length[here])
        ahead = int(np.searchsorted(path.arc_length, self.place + _AHEAD))
        return path.positions[here], path.positions[min(ahead, len(path.positions) - 1)]

    def _pull(
        self, way: Float[np.ndarray, " 3"], dt: float, time: float
    ) -> tuple[float, float, float]:
        """Pull along the way [N], lift beyond the weight [N] and upward part of the heading."""
        error = _SPEED - float(self._velocity @ way)
        self._integral = float(np.clip(self._integral + _INTEGRAL * error * dt, *_PULL))
        if self.place > self._best + _GAIN:
            self._best, self._since, self._hops = self.place, time, 0
        if time - self._since > _PATIENCE:
            self._since, self._hops = time + _HOP, self._hops + 1
        left = self._since - time
        if left <= 0.0:
            return float(np.clip(_PROPORTIONAL * error + self._integral, *_PULL)), -_REST, 0.0
        is_backward = self._hops % 3 == 0 and left > 0.5 * _HOP
        lift = min(self._hops, _HIGHEST_HOP) * _HOP_LIFT
        return -_HOP_PULL if is_backward else _HOP_PULL, lift, _HOP_PITCH

    def _led(
        self, R_world_capsule: Float[np.ndarray, "3 3"], heading: Float[np.ndarray, " 3"], dt: float
    ) -> Float[np.ndarray, "3 3"]:
        """Rotation of the capsule a little nearer to a heading than it was led before."""
        turn = clamp_norm(heading_error(self._heading[None], heading[None])[0], _TURN_RATE * dt)
        led = rotation_from_vector(turn) @ self._heading[:, 2]
        lead = clamp_norm(heading_error(R_world_capsule[None], led[None])[0], _LEAD)
        self._heading = rotation_from_vector(lead) @ R_world_capsule
        return self._heading

    def _towards(
        self, simulation: Simulation, T_world_capsule: Float[np.ndarray, "4 4"], dt: float
    ) -> Float[np.ndarray, " 6"]:
        """Action that moves the magnet to where a capsule at a pose would feel the force."""
        now = simulation.memory["magnet/T"][self._index]
        target = WrenchTarget(self._force.tolist(), motion_weight=_MOTION_WEIGHT)
        solution = self._solver.solve(target, T_world_capsule, now, max_iterations=_ITERATIONS)
        return magnet_action(self._actuation, now, solution.T_world_magnet, dt)


def _path(simulation: Simulation, index: int) -> WallPath:
    """Path along the lower wall from where the capsule is to its goal."""
    model, start = simulation.patient(index).model, float(simulation.arc_length[index])
    length, memory = float(simulation.course.length[index]), simulation.memory
    goal = length if start < 0.5 * length else 0.0
    if "navigate/goal" in memory:
        goal = float(memory["navigate/goal"][index])
    if abs(goal - start) < MM:  # nowhere to go: to the nearer side
        goal = start + MM if start < 0.5 * length else start - MM
    return centerline_wall_path(model, start, goal, wall="lower")


def _magnet_of(simulation: Simulation) -> MagnetActuation:
    """The actuation, which must be a magnet.

    Raises:
        InputError: If it is another.
    """
    actuation = simulation.settings.actuation
    if not isinstance(actuation, MagnetActuation):
        raise InputError(f"The navigator cannot drive {actuation.kind!r}. Allowed: magnet.")
    return actuation
