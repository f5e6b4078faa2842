"""Baselines without planning, and the route they follow: the passable part of a centerline."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core import rng
from vrcaps.core.geometry import unit
from vrcaps.core.units import CM, MM
from vrcaps.policy.policy import Requirements
from vrcaps.policy.servo import SERVO_ACTUATIONS, Goal, servo_actions

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

    from vrcaps.env.parts import EnvView
    from vrcaps.env.patients import Patient
    from vrcaps.env.vector_env import CapsuleVectorEnv
    from vrcaps.world.model import Model

_HELD = 6
"""Actions for which a choice is held: one second at the default control period."""

_FAR = 10.0 * CM
"""Distance of the target position."""

_NEAR = 8.0 * MM
"""Distance from an end at which it counts as reached."""

_PATIENCE = 4.0
"""Time without progress after which the capsule turns back [s]."""

_TILT = math.radians(70.0)
"""Angle between the front and the direction of travel [rad]."""

_TURN = 4.0
"""Period of a rotation about the direction of travel [s]."""

_SPACING = 2.0 * MM
"""Spacing of the positions on a centerline at which the capsule is tried."""

_PROBES = 8
"""Number of points of a straight path at which its clearance is tested."""


@dataclass(frozen=True)
class Route:
    """Passable part of an organ's centerline.

    Attributes:
        model: The organ and the capsule.
        ends: Arc lengths of the first and the last position at which the capsule fits [m].
    """

    model: Model
    ends: tuple[float, float]

    def poses(self, arc_length: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 4 4"]:
        """Poses that look towards the anal end, at arc lengths [m] clamped to the ends."""
        return self.model.centerline_poses(np.clip(arc_length, *self.ends))

    def fits(self, points: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Return whether a sphere of the capsule's radius fits at points in the world frame."""
        return np.asarray(self.model.wall.signed_distance(points)) > self.model.device.radius

    def is_free(
        self, points: Float[np.ndarray, "n 3"], headings: Float[np.ndarray, "n 3"]
    ) -> Bool[np.ndarray, " n"]:
        """Return whether the whole capsule fits at points with the given headings."""
        device = self.model.device
        half = (0.5 * device.length - device.radius) * headings
        ends = np.concatenate([points + half, points - half])
        return np.all(self.fits(ends).reshape(2, -1), axis=0)

    def is_clear(
        self, start: Float[np.ndarray, " 3"], points: Float[np.ndarray, "n 3"]
    ) -> Bool[np.ndarray, " n"]:
        """Return whether that sphere can move straight from a start to each of the points."""
        part = np.linspace(1.0, 0.0, _PROBES, endpoint=False)[:, None, None]
        way = start + part * (points - start)
        return np.all(self.fits(way.reshape(-1, 3)).reshape(_PROBES, -1), axis=0)


def make_route(model: Model) -> Route:
    """Create the route through an organ."""
    whole = Route(model, (0.0, model.organ.centerline.length))
    arc_length = np.linspace(*whole.ends, max(2, round(whole.ends[1] / _SPACING)))
    fitting = np.flatnonzero(whole.fits(whole.poses(arc_length)[:, :3, 3]))
    if len(fitting) == 0:
        return whole
    return Route(model, (float(arc_length[fitting[0]]), float(arc_length[fitting[-1]])))


class Routes:
    """Routes of an environment's patients, created on first use."""

    def __init__(self) -> None:
        self._made: dict[int, tuple[Patient, Route]] = {}

    def of(self, view: EnvView, index: int) -> Route:
        """Return the route of the patient of one world."""
        patient = view.patient(index)
        if id(patient) not in self._made:
            self._made[id(patient)] = (patient, make_route(patient.model))
        return self._made[id(patient)][1]


class RandomPolicy:
    """Random walk at constant speed, independent of observations.

    Random forces would not be a useful baseline: with inertia they throw the capsule about. For an
    actuation that the servo does not support, actions are sampled uniformly from the action space.
    """

    requires = Requirements()

    def __init__(self) -> None:
        self._draws: dict[int, np.random.Generator] = {}
        self._age: dict[int, int] = {}
        self._held: dict[int, np.ndarray] = {}

    def reset(self, indices: np.ndarray, seeds: Sequence[int]) -> None:
        """Start a random stream for each world."""
        for index, seed in zip(np.asarray(indices).tolist(), seeds, strict=True):
            self._draws[index] = rng.stream(int(seed), "policy/random")
            self._age[index] = 0

    def act(self, observations: dict[str, np.ndarray], env: CapsuleVectorEnv) -> np.ndarray:
        """Return the current actions."""
        is_walk = env.settings.actuation.kind in SERVO_ACTUATIONS
        space = env.single_action_space
        for index in range(env.num_envs):
            if self._age[index] % _HELD == 0:
                draw = self._draws[index]
                self._held[index] = (
                    unit(draw.normal(size=(2, 3))) if is_walk else _action(space, draw)
                )
            self._age[index] += 1
        held = np.stack([self._held[k] for k in range(env.num_envs)])
        if not is_walk:
            return held.astype(space.dtype)
        view = env.view
        position = view.T_world_capsule[:, :3, 3] + _FAR * held[:, 0]
        return servo_actions(view, Goal(position, held[:, 1]))


def _action(space: object, draw: np.random.Generator) -> np.ndarray:
    """One action of a box or of a discrete space."""
    low, high = getattr(space, "low", None), getattr(space, "high", None)
    if low is not None and high is not None:
        return draw.uniform(low, high)
    count, start = int(space.n), int(space.start)  # type: ignore[attr-defined]
    return np.asarray(start + draw.integers(count))


@dataclass
class Walk:
    """Progress of one capsule along its route.

    Attributes:
        sign: 1 towards the anal end, −1 towards the oral end, 0 before the first action.
        farthest: Farthest arc length reached since the last turn [m].
        since: Time at which it was reached [s].
    """

    sign: int = 0
    farthest: float = 0.0
    since: float = 0.0

    def follow(self, route: Route, arc_length: float, time: float) -> None:
        """Update the progress; turn back at the ends and when the capsule is stuck.

        Args:
            route: Route of the capsule.
            arc_length: Arc length of the capsule [m].
            time: Current time [s].
        """
        low, high = route.ends
        if self.sign == 0:  # the nearer end first
            self.sign = 1 if high - arc_length < arc_length - low else -1
            self.farthest, self.since = arc_length, time
        if self.sign * (arc_length - self.farthest) > 1.0 * MM:
            self.farthest, self.since = arc_length, time
        left = high - arc_length if self.sign > 0 else arc_length - low
        if left < _NEAR or time - self.since > _PATIENCE:
            self.sign, self.farthest, self.since = -self.sign, arc_length, time


class CenterlinePolicy:
    """Follow the centerline to the nearer end, then back and forth."""

    requires = Requirements(actuations=SERVO_ACTUATIONS)
    speed = 30.0 * MM
    ahead = 15.0 * MM
    """Lookahead distance of the goal on the centerline [m]."""

    def __init__(self) -> None:
        self._routes = Routes()
        self._walks: dict[int, Walk] = {}

    def reset(self, indices: np.ndarray, seeds: Sequence[int]) -> None:
        """Reset the progress of some worlds."""
        for index in np.asarray(indices).tolist():
            self._walks[index] = Walk()

    def act(self, observations: dict[str, np.ndarray], env: CapsuleVectorEnv) -> np.ndarray:
        """Return actions towards the next position on the centerline."""
        view = env.view
        goals = [self._goal(view, k) for k in range(env.num_envs)]
        position, heading = (np.stack(part) for part in zip(*goals, strict=True))
        return servo_actions(view, Goal(position, heading, self.speed))

    def _goal(self, view: EnvView, index: int) -> tuple[np.ndarray, np.ndarray]:
        """Position and heading of one capsule's goal."""
        route, walk = self._routes.of(view, index), self._walks[index]
        now, time = float(view.arc_length[index]), float(view.time[index])
        walk.follow(route, now, time)
        pose = route.poses(np.array([now + walk.sign * self.ahead]))[0]
        return pose[:3, 3], self.heading(pose[:3, :3], walk.sign, time)

    def heading(
        self, R_world_line: Float[np.ndarray, "3 3"], sign: int, time: float
    ) -> Float[np.ndarray, " 3"]:
        """Viewing direction: straight ahead.

        Args:
            R_world_line: Rotation of the centerline's frame; its z axis points to the anal end.
            sign: Direction of travel along the centerline.
            time: Time since the start of the episode [s].
        """
        return sign * R_world_line[:, 2]


class LookAroundPolicy(CenterlinePolicy):
    """Follow the centerline at lower speed, with views that spiral along the wall."""

    speed = 15.0 * MM
    ahead = 8.0 * MM

    def heading(
        self, R_world_line: Float[np.ndarray, "3 3"], sign: int, time: float
    ) -> Float[np.ndarray, " 3"]:
        """Viewing direction, rotating on the cone; see `CenterlinePolicy.heading`."""
        phase = 2.0 * math.pi * time / _TURN
        around = np.array([math.cos(phase), math.sin(phase), 0.0]) * math.sin(_TILT)
        return R_world_line @ (around + np.array([0.0, 0.0, sign * math.cos(_TILT)]))
