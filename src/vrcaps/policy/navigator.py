"""Navigator policy: a magnet guides the capsule along the lower wall of the gut to its goal.

Each capsule follows a path along the wall, see `centerline_wall_path`. In every control period the
magnet pose is solved for which the capsule's front turns to the direction t towards a lookahead
point on the path, and the capsule feels the force

    F = (m g − R) up + (k_p e + k_i ∫e dt) t,    e = v* − v·t

with the weight R that rests on the wall and the speed v* along the path. The rate of F is limited,
so that the magnet can follow. When a fold stops the capsule, the integral grows. If that is not
enough, the capsule hops: it is lifted off the wall with its nose up for some time, with more force
in each hop.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.actuation.magnet_pose_solver import MagnetPoseSolver, Workspace, WrenchTarget
from vrcaps.actuation.wall_path import WallPath, centerline_wall_path
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import clamp_norm, rotation_from_vector, unit
from vrcaps.core.units import CM, MM
from vrcaps.env.actuation import MagnetActuation
from vrcaps.magnet.field import SourceSet
from vrcaps.magnet.presets import read_magnet
from vrcaps.policy.policy import Requirements
from vrcaps.policy.servo import heading_error, magnet_action
from vrcaps.world.control import GRAVITY

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.capsule.device import Device
    from vrcaps.env.parts import EnvView
    from vrcaps.env.vector_env import CapsuleVectorEnv
    from vrcaps.magnet.sources import Magnet

_SPEED = 2.0 * CM
"""Speed v* along the path [m/s]."""

_AHEAD, _NEARBY = 20.0 * MM, 40.0 * MM
"""Lookahead distance on the path, and search radius around the capsule's position there [m]."""

_REST = 0.04
"""Weight R that rests on the wall [N]."""

_PROPORTIONAL, _INTEGRAL = 0.3, 0.8
"""Gains k_p [N·s/m] and k_i [N/m]."""

_PULL = (-0.04, 0.07)
"""Minimum and maximum pull along the path [N]."""

_HEIGHT, _HEIGHT_GAIN, _SINK = 8.0 * MM, 3.0, 0.06
"""Height above the path from which the support is reduced [m], its gain [N/m] and maximum [N]."""

_SMOOTHING = 0.5
"""Time over which velocity is averaged [s]."""

_FORCE_RATE, _TURN_RATE, _LEAD = 0.08, 0.6, 0.6
"""Maximum rates of force [N/s] and heading [rad/s]; maximum lead angle of the heading [rad]."""

_PATIENCE, _GAIN = 4.0, 5.0 * MM
"""Time without this gain along the path after which the capsule hops [s], [m]."""

_HOP, _HOP_PULL, _HOP_PITCH = 3.0, 0.05, 0.5
"""Duration of a hop [s], pull during it [N], upward component of its heading."""

_HOP_LIFT, _HIGHEST_HOP = 0.02, 5
"""Lift beyond the weight in the first hop [N]; index of the hop after which it stops growing. Every
third hop starts backward."""

_MOTION_WEIGHT = 1.0
"""Weight of the magnet's displacement, relative to force errors of 10 mN."""

_ITERATIONS = 10


class NavigatorPolicy:
    """Guide capsules to the goal of `navigate`; without one, to the farther end of the gut."""

    requires = Requirements(
        settings={"task": "navigate", "control_period": 0.05}, actuations=("magnet",)
    )

    def __init__(self) -> None:
        self._guides: dict[int, Guide] = {}

    def reset(self, indices: np.ndarray, seeds: Sequence[int]) -> None:
        """Discard the paths of some worlds."""
        for index in np.asarray(indices).tolist():
            self._guides.pop(index, None)

    def act(self, observations: dict[str, np.ndarray], env: CapsuleVectorEnv) -> np.ndarray:
        """Return the magnets' twists for the next control period."""
        view = env.view
        for index in range(env.num_envs):
            if index not in self._guides:
                self._guides[index] = Guide(view, index)
        twists = [self._guides[index].twist(view) for index in range(env.num_envs)]
        return np.array(twists, np.float32)


class Guide:
    """Guide of the capsule in one world, with its path and the controller's state.

    Attributes:
        path: Path along the wall.
        arc_length: Arc length of the capsule along it [m].
    """

    def __init__(self, view: EnvView, index: int) -> None:
        """Plan the path.

        Args:
            view: EnvView at the start of an episode.
            index: Index of the world.
        """
        self._actuation, T = _magnet_of(view), view.T_world_capsule[index]
        device, box = view.patient(index).model.device, view.memory["magnet/box"][index]
        self._controller = ForceController(
            device, read_magnet(self._actuation.magnet), box, T[:3, :3]
        )
        self._index = index
        self.path, self.arc_length = _path(view, index), 0.0
        self._position, self._velocity = T[:3, 3].copy(), np.zeros(3)
        self._integral = 0.0
        self._best, self._since, self._hops = 0.0, 0.0, 0

    def twist(self, view: EnvView) -> Float[np.ndarray, " 6"]:
        """Return the magnet's action for the next control period."""
        dt, T = view.control_period, view.T_world_capsule[self._index]
        self._velocity += min(dt / _SMOOTHING, 1.0) * (
            (T[:3, 3] - self._position) / dt - self._velocity
        )
        self._position = T[:3, 3].copy()
        here, ahead = self._path_points(self._position)
        way = unit(ahead - self._position)
        pull, lift, pitch = self._pull(way, dt, float(view.time[self._index]))
        sink = min(_HEIGHT_GAIN * max(self._position[2] - here[2] - _HEIGHT, 0.0), _SINK)
        force = pull * way + np.array([0.0, 0.0, lift - sink])
        heading, now = unit(way + np.array([0.0, 0.0, pitch])), view.memory["magnet/T"][self._index]
        wanted = self._controller.magnet_pose(T, now, force, heading, dt)
        return magnet_action(self._actuation, now, wanted, dt)

    def _path_points(
        self, position: Float[np.ndarray, " 3"]
    ) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"]]:
        """Closest point on the path and the lookahead point [m]."""
        path = self.path
        away = np.abs(path.arc_length - self.arc_length)
        squares = np.sum((path.positions - position) ** 2, axis=1)
        here = int(np.where(away < _NEARBY, squares, np.inf).argmin())
        self.arc_length = float(path.arc_length[here])
        ahead = int(np.searchsorted(path.arc_length, self.arc_length + _AHEAD))
        return path.positions[here], path.positions[min(ahead, len(path.positions) - 1)]

    def _pull(
        self, way: Float[np.ndarray, " 3"], dt: float, time: float
    ) -> tuple[float, float, float]:
        """Pull along the path [N], lift beyond the weight [N], upward component of the heading."""
        error = _SPEED - float(self._velocity @ way)
        self._integral = float(np.clip(self._integral + _INTEGRAL * error * dt, *_PULL))
        if self.arc_length > self._best + _GAIN:
            self._best, self._since, self._hops = self.arc_length, time, 0
        if time - self._since > _PATIENCE:
            self._since, self._hops = time + _HOP, self._hops + 1
        left = self._since - time
        if left <= 0.0:
            return float(np.clip(_PROPORTIONAL * error + self._integral, *_PULL)), -_REST, 0.0
        is_backward = self._hops % 3 == 0 and left > 0.5 * _HOP
        lift = min(self._hops, _HIGHEST_HOP) * _HOP_LIFT
        return -_HOP_PULL if is_backward else _HOP_PULL, lift, _HOP_PITCH


class ForceController:
    """Poses of a magnet that exert a force on a capsule and turn its front to a heading.

    Force and heading change at limited rates, so that the magnet can follow.

    Attributes:
        weight: Weight of the capsule [N].
        unlimited_decrease: Fraction of a decrease of the upward force that is not limited in rate.
        max_lead_angle: Maximum angle between the heading and the capsule's front [rad].
    """

    unlimited_decrease = 0.0
    max_lead_angle = _LEAD

    def __init__(
        self,
        device: Device,
        magnet: Magnet,
        box: Float[np.ndarray, "2 3"],
        R_world_capsule: Float[np.ndarray, "3 3"],
    ) -> None:
        """Start with the magnet above the capsule, which rests on the wall.

        Args:
            device: The capsule.
            magnet: The external magnet; its pose is ignored.
            box: Minimum and maximum positions of its center [m].
            R_world_capsule: Rotation of the capsule.
        """
        low, high = box.tolist()
        workspace = Workspace(tuple(low), tuple(high), 0.5 * magnet.bounds[0] + 3.0 * CM)
        self._solver = MagnetPoseSolver(SourceSet([magnet]), device.magnets, workspace)
        self._magnet, self._inside = magnet, device.magnets
        self.weight = device.mass * GRAVITY
        self._heading = R_world_capsule.copy()
        self._force = np.array([0.0, 0.0, self.weight - _REST])

    def magnet_pose(
        self,
        T_world_capsule: Float[np.ndarray, "4 4"],
        T_world_magnet: Float[np.ndarray, "4 4"],
        force: Float[np.ndarray, " 3"],
        heading: Float[np.ndarray, " 3"],
        dt: float,
    ) -> Float[np.ndarray, "4 4"]:
        """Pose of the magnet at the end of a control period.

        Args:
            T_world_capsule: Pose of the capsule.
            T_world_magnet: Pose of the magnet.
            force: Force in addition to the support of the capsule's weight [N].
            heading: Direction to which its front turns.
            dt: Control period [s].
        """
        wanted = force + np.array([0.0, 0.0, self.weight])
        if wanted[2] < self._force[2]:  # a capsule that rises is released at once
            self._force[2] += self.unlimited_decrease * (wanted[2] - self._force[2])
        self._force = self._force + clamp_norm(wanted - self._force, _FORCE_RATE * dt)
        T_led = T_world_capsule.copy()
        T_led[:3, :3] = self._led(T_world_capsule[:3, :3], heading, dt)
        target = WrenchTarget(self._force.tolist(), motion_weight=_MOTION_WEIGHT)
        solution = self._solver.solve(target, T_led, T_world_magnet, max_iterations=_ITERATIONS)
        return solution.T_world_magnet

    def force_error(
        self, T_world_capsule: Float[np.ndarray, "4 4"], T_world_magnet: Float[np.ndarray, "4 4"]
    ) -> float:
        """Maximum difference between the force of a magnet and the desired one [N].

        Over two poses: the capsule as it lies, and aligned with the field of the magnet.
        """
        sources = SourceSet([replace(self._magnet, T_world_magnet=T_world_magnet)])
        aligned = T_world_capsule.copy()
        moment = T_world_capsule[:3, :3] @ self._solver.moment
        flux = sources.field(T_world_capsule[None, :3, 3])[0][0]
        turn = np.cross(moment, flux)
        sine, cosine = float(np.linalg.norm(turn)), float(moment @ flux)
        angle = np.arctan2(sine, cosine) / max(sine, 1e-12)
        aligned[:3, :3] = rotation_from_vector(angle * turn) @ aligned[:3, :3]
        forces, _ = sources.wrench(self._inside, np.stack([T_world_capsule, aligned]))
        return float(np.linalg.norm(forces - self._force, axis=1).max())

    def _led(
        self, R_world_capsule: Float[np.ndarray, "3 3"], heading: Float[np.ndarray, " 3"], dt: float
    ) -> Float[np.ndarray, "3 3"]:
        """Rotation of the capsule, turned from the previous reference towards a heading."""
        turn = clamp_norm(heading_error(self._heading[None], heading[None])[0], _TURN_RATE * dt)
        led = rotation_from_vector(turn) @ self._heading[:, 2]
        lead = clamp_norm(heading_error(R_world_capsule[None], led[None])[0], self.max_lead_angle)
        self._heading = rotation_from_vector(lead) @ R_world_capsule
        return self._heading


def _path(view: EnvView, index: int) -> WallPath:
    """Path along the lower wall from the capsule to its goal."""
    model, start = view.patient(index).model, float(view.arc_length[index])
    length, memory = float(view.course.length[index]), view.memory
    goal = length if start < 0.5 * length else 0.0
    if "navigate/goal" in memory:
        goal = float(memory["navigate/goal"][index])
    if abs(goal - start) < MM:  # already at the goal: move to the nearer side
        goal = start + MM if start < 0.5 * length else start - MM
    return centerline_wall_path(model, start, goal, wall="lower")


def _magnet_of(view: EnvView) -> MagnetActuation:
    """Return the actuation, which must be a magnet.

    Raises:
        InputError: If it is another.
    """
    actuation = view.actuation
    if not isinstance(actuation, MagnetActuation):
        raise InputError(
            f"The navigator does not support actuation {actuation.kind!r}. Allowed: magnet."
        )
    return actuation
