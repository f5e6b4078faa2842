"""Explorer policy: a magnet moves the capsule to views of space that is unknown in its own map.

It reads only quantities of a device: the pose and velocity that a tracker estimates, the commanded
pose of the magnet, the time, and an image of distances. From these it builds a `VoxelMap`. A plan
is a position on the lower wall of the mapped space, which a path over free voxels reaches, and a
viewing direction; it has the largest area of unknown space per time. The magnet turns the capsule
to that direction and pulls it along the path with the force

    F = (m g − R − s) up + (k_p (v* − v·t) + i) t − k_p v_across

with the weight R that rests on the wall, the reduction s of the support of a capsule that rises,
the speed v* and the direction t along the path, and an integral i that grows while the capsule is
stopped. A capsule that remains stopped hops, as in `navigator`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core import rng
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import rotation_from_vector, unit
from vrcaps.core.units import CM, MM
from vrcaps.env.actuation import ArmActuation, MagnetActuation
from vrcaps.env.exploration import HEADINGS, VoxelMap, floor_paths, image_rays
from vrcaps.env.observations import ImageObservation, StateObservation
from vrcaps.magnet.pose import magnet_pose
from vrcaps.magnet.presets import read_magnet
from vrcaps.policy.navigator import ForceController
from vrcaps.policy.policy import Requirements
from vrcaps.policy.servo import magnet_action

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.env.parts import EnvView
    from vrcaps.env.vector_env import CapsuleVectorEnv

_SIZE = (40, 40)
_IMAGE_PERIOD = 0.25
"""Time between images that are added to the map [s]."""

_NUM_CANDIDATES = 40
_SPEED, _TURN = 1.0 * CM, 0.4
"""Speed [m/s] and angular speed [rad/s] that plans assume."""

_PAUSE = 2.0
"""Fixed time cost of a view [s]."""

_AT, _ALIGNED = 12.0 * MM, 0.3
"""Distance [m] and angle [rad] from a view at which it counts as reached."""

_AHEAD = 20.0 * MM
"""Lookahead distance on the path [m]."""

_TOP_SPEED, _SMOOTHING = 2.0 * CM, 0.25
"""Maximum speed v* [m/s]; time over which the velocity is averaged [s]."""

_PROPORTIONAL, _INTEGRAL, _MAX_INTEGRAL = 0.5, 0.5, 0.04
"""Gain k_p [N·s/m]; rate of the integral [N/m] and its maximum [N]."""

_RATE, _STALLED = 1.0, 0.3
"""Fraction of the remaining distance that v* covers per second, and rate at which the integral of
a moving capsule decays [1/s]; fraction of v* below which the integral grows."""

_PULL = (-0.03, 0.05)
"""Minimum and maximum pull along the path [N]."""

_REST = 0.06
"""Weight R that rests on the wall [N]."""

_HEIGHT, _HEIGHT_GAIN, _SINK, _DAMPING = 12.0 * MM, 3.0, 0.08, 1.0
"""Height above the path from which the support is reduced [m], its gain [N/m], the maximum of each
reduction [N], and the reduction by upward speed [N·s/m]."""

_PATIENCE, _GAIN = 4.0, 5.0 * MM
"""Time without this approach to the view after which the capsule hops [s], [m]."""

_HOP, _HOP_PULL, _HOP_PITCH, _HOP_LIFT, _MAX_HOPS = 3.0, 0.05, 0.5, 0.01, 3
"""Duration of a hop [s], pull [N], upward component of its heading, lift beyond the weight in the
first hop [N], which grows with each; number of hops after which the view is abandoned."""

_PART, _CLOSE, _MAX_BLOCKED = 0.85, 12.0 * MM, 8
"""A view is blocked if this part of its distances is below the limit [m]; number of images without
another view after which the capsule is pulled away."""

_ESCAPE = 2.5
"""Duration of such a pull [s]."""

_LEAD = 0.3
"""Maximum angle between the heading of the field and the capsule's front [rad]."""

_PARTS, _HASTE = (1.0, 0.6, 0.3, 0.0), 0.01
"""Tried fractions of a rotation of the magnet; force error that a whole one may cause [N]."""

_MIN_GAIN = 2e-5
"""Area of unknown space below which the map counts as complete [m²]."""


@dataclass(frozen=True)
class Reading:
    """Values of one world that a device can measure, relative to the tracker's origin.

    Attributes:
        T_capsule: Estimated pose of the capsule.
        velocity: Estimated velocity [m/s].
        T_magnet: Commanded pose of the magnet, up to the rotation about its moment.
        time: Time since the start [s].
    """

    T_capsule: Float[np.ndarray, "4 4"]
    velocity: Float[np.ndarray, " 3"]
    T_magnet: Float[np.ndarray, "4 4"]
    time: float


def read_state(row: Float[np.ndarray, " 25"], episode_time: float) -> Reading:
    """Decode a row of `StateObservation` with a magnet."""
    row = np.asarray(row, float)
    z = unit(row[6:9])
    x = unit(row[3:6] - z * float(z @ row[3:6]))
    T = np.eye(4)
    T[:3, :3] = np.column_stack([x, np.cross(z, x), z])
    T[:3, 3] = 10.0 * CM * row[:3]
    magnet = magnet_pose(T[:3, 3] + 10.0 * CM * row[19:22], row[22:25])
    return Reading(T, 20.0 * MM * row[9:12], magnet, float(row[18]) * episode_time)


@dataclass
class _Plan:
    """A view and the way to it.

    Attributes:
        path: Positions from the capsule to the view [n 3].
        heading: Direction of the front at its end.
        gain: Area of unknown space that it should show [m²].
        until: Time at which it is abandoned [s].
        pull: Constant force beyond the weight that frees a capsule whose view is blocked [N].
        best: Shortest distance to its end so far [m].
        since: Time at which that was reached, or at which a hop ends [s].
        hops: Number of hops so far.
    """

    path: np.ndarray
    heading: np.ndarray
    gain: float
    until: float
    pull: np.ndarray | None = None
    best: float = np.inf
    since: float = 0.0
    hops: int = 0


class ExplorerPolicy:
    """Planner of views of unknown space, from the observations alone."""

    requires = Requirements(
        settings={
            "actuation": "magnet",
            "observations": (
                StateObservation(pose="located"),
                ImageObservation("ray_distance", size=_SIZE, noise=0.05),
            ),
            "control_period": 0.1,
        },
        observations=("state", "ray_distance"),
        actuations=("magnet", "arm"),
    )

    def __init__(self) -> None:
        self._explorers: dict[int, Explorer] = {}
        self._seeds: dict[int, int] = {}

    def reset(self, indices: np.ndarray, seeds: Sequence[int]) -> None:
        """Discard the maps of some worlds."""
        for index, seed in zip(np.asarray(indices).tolist(), seeds, strict=True):
            self._explorers.pop(index, None)
            self._seeds[index] = int(seed)

    def act(self, observations: dict[str, np.ndarray], env: CapsuleVectorEnv) -> np.ndarray:
        """Return the actions for the next control period."""
        actions = []
        for index in range(env.num_envs):
            reading = read_state(observations["state"][index], env.settings.episode_time)
            if index not in self._explorers:
                seed = self._seeds.get(index, 0)
                drive = Drive(env.view, index, reading.T_capsule[:3, :3])
                self._explorers[index] = Explorer(env.view, drive, seed)
            distances = observations["ray_distance"][index, ..., 0]
            actions.append(self._explorers[index].action(reading, distances))
        return np.array(actions, np.float32)


class Drive:
    """Magnet of one world, free or on an arm, in the coordinates of the tracker."""

    def __init__(self, view: EnvView, index: int, R_world_capsule: np.ndarray) -> None:
        """Read the installation: capsule, magnet, its workspace, and the arm's base.

        Raises:
            InputError: If the actuation is another.
        """
        actuation, memory = view.actuation, view.memory
        self._view, self._index, self._actuation = view, index, actuation
        self.dt, origin = view.control_period, memory["state/center"][index]
        if isinstance(actuation, MagnetActuation):
            box = memory["magnet/box"][index] - origin
        elif isinstance(actuation, ArmActuation):
            self._base = memory["arm/base"][index] - origin
            box = actuation.box + self._base
        else:
            raise InputError(
                f"The explorer does not support {actuation.kind!r}. Allowed: magnet, arm."
            )
        magnet = read_magnet(actuation.magnet)
        self._controller = ForceController(view.device, magnet, box, R_world_capsule)
        self._controller.unlimited_decrease, self._controller.max_lead_angle = 1.0, _LEAD

    def action(self, reading: Reading, force: np.ndarray, heading: np.ndarray) -> np.ndarray:
        """Action towards a force beyond the weight [N] and a heading."""
        now = reading.T_magnet
        wanted = self._controller.magnet_pose(reading.T_capsule, now, force, heading, self.dt)
        if isinstance(self._actuation, MagnetActuation):
            action = magnet_action(self._actuation, now, wanted, self.dt)
            return self._gentlest(action, reading)
        assert isinstance(self._actuation, ArmActuation)
        wanted[:3, 3] -= self._base
        angles = self._view.memory["arm/joints"][self._index]  # the arm's encoders
        return self._actuation.towards(angles, wanted, self.dt)

    def _gentlest(self, action: np.ndarray, reading: Reading) -> np.ndarray:
        """Action with as much rotation as keeps the force near the desired one."""
        actuation, best = self._actuation, (np.inf, action)
        assert isinstance(actuation, MagnetActuation)
        for part in _PARTS:
            some = np.concatenate([action[:3], part * action[3:]])
            moved = reading.T_magnet.copy()
            moved[:3, 3] += actuation.speed * self.dt * some[:3]
            turn = rotation_from_vector(actuation.angular_speed * self.dt * some[3:])
            moved[:3, :3] = turn @ moved[:3, :3]
            error = self._controller.force_error(reading.T_capsule, moved)
            best = min(best, (error + (1.0 - part) * _HASTE, some), key=lambda pair: pair[0])
        return best[1]


class Explorer:
    """Map, plan and controller of one capsule."""

    def __init__(self, view: EnvView, drive: Drive, seed: int) -> None:
        self.map, self._drive, self._draw = VoxelMap(), drive, rng.stream(seed, "policy/explorer")
        self._T_capsule_camera = view.device.cameras[0].T_capsule_camera
        self._rays = image_rays(view.device, _SIZE)
        self._plan: _Plan | None = None
        self._time, self._next_image, self._next_check = -np.inf, 0.0, 0.0
        self._velocity, self._integral = np.zeros(3), 0.0
        self._failed: list[np.ndarray] = []
        self._blocked, self._escapes = 0, 0

    def action(self, reading: Reading, distances: Float[np.ndarray, "h w"]) -> np.ndarray:
        """Action for a reading and an image of distances [m].

        The observed time ends at ten episode times, which a drive in the cockpit may exceed; from
        then on control periods are counted.
        """
        if reading.time <= self._time:
            reading = replace(reading, time=self._time + self._drive.dt)
        self._time = reading.time
        T_camera = reading.T_capsule @ self._T_capsule_camera
        if reading.time >= self._next_image - 1e-9:
            self._next_image = reading.time + _IMAGE_PERIOD
            rays = self._rays @ reading.T_capsule[:3, :3].T
            is_ray = np.isfinite(rays).all(axis=1)
            seen = distances.ravel()[is_ray]
            self.map.add(T_camera[:3, 3], rays[is_ray], seen)
            is_blocked = np.quantile(seen, _PART) < _CLOSE
            self._blocked = self._blocked + 1 if is_blocked else 0
        plan = self._plan
        if plan is None or self._is_over(plan, reading):
            plan = self._plan = self._best(reading)
        force, heading = self._control(plan, reading)
        return self._drive.action(reading, force, heading)

    def _is_over(self, plan: _Plan, reading: Reading) -> bool:
        """Whether a plan is completed, shown on the way, or abandoned."""
        T, time = reading.T_capsule, reading.time
        if plan.pull is not None:
            return time > plan.until
        if self._blocked > _MAX_BLOCKED:
            return True
        left = float(np.linalg.norm(plan.path[-1] - T[:3, 3]))
        angle = float(np.arccos(np.clip(plan.heading @ T[:3, 2], -1.0, 1.0)))
        camera = (T @ self._T_capsule_camera)[:3, 3]
        if (left < _AT and angle < _ALIGNED) or time > plan.until or plan.hops > _MAX_HOPS:
            if plan.hops > _MAX_HOPS or (time > plan.until and left > 2.0 * _AT):
                self._failed = [*self._failed[-7:], plan.path[-1]]
            self.map.complete(camera, T[:3, 2])
            self.map.complete(plan.path[-1], plan.heading)
            return True
        if time >= self._next_check - 1e-9:
            self._next_check = time + 1.0
            gains = self.map.gains(plan.path[-1:])[0]
            return bool(gains[(HEADINGS @ plan.heading).argmax()] < 0.3 * plan.gain)
        return False

    def _best(self, reading: Reading) -> _Plan:
        """Plan with the greatest gain per time; without a view, a pull backward."""
        T, time = reading.T_capsule, reading.time
        here, front = T[:3, 3], T[:3, 2]
        if self._blocked > _MAX_BLOCKED:
            return self._escape(here, front, time)
        self._escapes = max(0, self._escapes - 1)
        ends, lengths, path_to = floor_paths(self.map, here)
        for failed in self._failed:
            keep = np.linalg.norm(ends - failed, axis=1) > 12.0 * MM
            ends, lengths = ends[keep], lengths[keep]
        some = self._draw.permutation(len(ends))[:_NUM_CANDIDATES]
        points = np.concatenate([here[None], ends[some]])
        ways = np.concatenate([[0.0], lengths[some]])
        gains = self.map.gains(points + np.array([0.0, 0.0, 2.0 * MM]))
        turns = np.arccos(np.clip(HEADINGS @ front, -1.0, 1.0)) / _TURN
        times = np.maximum(ways[:, None] / _SPEED, turns) + _PAUSE  # it turns on the way
        rate = gains / times
        if gains.max() < _MIN_GAIN:  # nothing is left: patrol
            rate = self._draw.random(rate.shape)
        point, turn = np.unravel_index(int(rate.argmax()), rate.shape)
        path = np.stack([here, points[point]])
        if point > 0:
            path = path_to(points[point])
        until = time + 2.0 * float(times[point, turn]) + 4.0
        return _Plan(path, HEADINGS[turn], float(gains[point, turn]), until, since=time)

    def _escape(self, here: np.ndarray, front: np.ndarray, time: float) -> _Plan:
        """Pull away from the wall in front, each time stronger and in another direction."""
        self._escapes += 1
        strength = min(0.03 + 0.01 * self._escapes, 0.1)
        way = unit(-front + (0.3 + 0.1 * self._escapes) * self._draw.normal(size=3))
        pull = strength * way
        pull[2] = max(pull[2], -_REST)
        self._blocked = 0
        return _Plan(np.stack([here, here]), front, 0.0, time + _ESCAPE, pull=pull)

    def _control(self, plan: _Plan, reading: Reading) -> tuple[np.ndarray, np.ndarray]:
        """Force beyond the weight [N] and heading."""
        T, dt, time = reading.T_capsule, self._drive.dt, reading.time
        here = T[:3, 3]
        if plan.pull is not None:
            return plan.pull, plan.heading
        self._velocity += min(dt / _SMOOTHING, 1.0) * (reading.velocity - self._velocity)
        left = float(np.linalg.norm(plan.path[-1] - here))
        if left < plan.best - _GAIN:
            plan.best, plan.since, plan.hops = left, max(time, plan.since), plan.hops
        below = plan.path[int(np.sum((plan.path - here)[:, :2] ** 2, axis=1).argmin()), 2]
        sink = np.clip(_HEIGHT_GAIN * (here[2] - below - _HEIGHT), 0.0, _SINK)
        sink += np.clip(_DAMPING * reading.velocity[2], 0.0, _SINK)
        down = np.array([0.0, 0.0, -_REST - sink])
        if left < _AT:
            self._integral = 0.0
            return down, plan.heading
        way = unit(self._ahead(plan.path, here) - here)
        if time - plan.since > _PATIENCE:
            plan.since, plan.hops = time + _HOP, plan.hops + 1
        if plan.since > time:
            lift = min(plan.hops, _MAX_HOPS) * _HOP_LIFT
            heading = unit(way + np.array([0.0, 0.0, _HOP_PITCH]))
            return _HOP_PULL * way + np.array([0.0, 0.0, lift]), heading
        wanted = min(_TOP_SPEED, _RATE * left)
        along = float(self._velocity @ way)
        if along < _STALLED * wanted:
            self._integral = min(self._integral + _INTEGRAL * wanted * dt, _MAX_INTEGRAL)
        else:
            self._integral *= max(0.0, 1.0 - _RATE * dt)
        pull = float(np.clip(_PROPORTIONAL * (wanted - along) + self._integral, *_PULL))
        across = self._velocity - along * way
        across[2] = 0.0
        return down + pull * way - _PROPORTIONAL * across, plan.heading

    @staticmethod
    def _ahead(path: np.ndarray, here: np.ndarray) -> np.ndarray:
        """Point of a path ahead of the nearest one."""
        nearest = int(np.sum((path - here) ** 2, axis=1).argmin())
        away = np.linalg.norm(np.diff(path[nearest:], axis=0), axis=1).cumsum()
        index = nearest + 1 + int(np.searchsorted(away, _AHEAD))
        return path[min(index, len(path) - 1)]
