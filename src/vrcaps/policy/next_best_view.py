"""Next-best-view policy: go to the view with the most unseen wall per unit of time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core import rng
from vrcaps.core.geometry import look_along, transform_from, unit
from vrcaps.core.units import CM, MM
from vrcaps.metrics.point_coverage import POINT_LEVELS, mark_points
from vrcaps.policy.baselines import Route, Routes
from vrcaps.policy.policy import Requirements
from vrcaps.policy.servo import SERVO_ACTUATIONS, Goal, heading_error, servo_actions

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.env.parts import EnvView
    from vrcaps.env.vector_env import CapsuleVectorEnv

_NUM_NEAR, _NUM_HEADINGS = 24, 4
_REACH = 6.0 * CM
"""Maximum length of a straight path to a candidate."""

_ALONG = np.array([1.0, 2.0, 4.0, 7.0, 11.0, 16.0]) * CM
"""Distances of candidates along the centerline, in both directions."""

_SHARE = 0.4
"""Fraction of the unseen points that is used to evaluate candidates."""

_ALL_SEEN = (1 << len(POINT_LEVELS)) - 1
_SPEED, _TURN = 40.0 * MM, 2.0
_PAUSE = 0.5
"""Fixed time cost of every view [s]; without it the nearest view would always win."""

_AT, _ALIGNED = 4.0 * MM, 0.2
"""Distance [m] and angle [rad] from a view at which it counts as reached."""

_STILL = (2.0 * MM, 0.1)
"""Speed [m/s] and angular speed [rad/s] below which a moving capsule counts as stuck."""


@dataclass
class _Plan:
    """Plan of one capsule: its current target view.

    Attributes:
        position: Position of the view [m].
        heading: Direction of the front there.
        arc_length: End of the path along the centerline [m]; NaN if the path is straight.
        start: Time at which the plan was made [s].
        until: Time at which it is abandoned [s].
    """

    position: np.ndarray
    heading: np.ndarray
    arc_length: float
    start: float
    until: float


class NextBestViewPolicy:
    """Greedy planner that knows the organ's shape: best gain of unseen area over travel time."""

    requires = Requirements(actuations=SERVO_ACTUATIONS)

    def __init__(self) -> None:
        self._routes = Routes()
        self._draws: dict[int, np.random.Generator] = {}
        self._plans: dict[int, _Plan | None] = {}

    def reset(self, indices: np.ndarray, seeds: Sequence[int]) -> None:
        """Discard the plans of some worlds."""
        for index, seed in zip(np.asarray(indices).tolist(), seeds, strict=True):
            self._draws[index] = rng.stream(int(seed), "policy/next-best-view")
            self._plans[index] = None

    def act(self, observations: dict[str, np.ndarray], env: CapsuleVectorEnv) -> np.ndarray:
        """Return actions towards the planned view, or towards a new one when it is reached."""
        view = env.view
        goals = []
        for index in range(env.num_envs):
            plan = self._plans[index]
            if plan is None or _is_over(view, index, plan):
                plan = self._plans[index] = self._best(view, index)
            goals.append((self._next(view, index, plan), plan.heading))
        position, heading = (np.stack(part) for part in zip(*goals, strict=True))
        return servo_actions(view, Goal(position, heading, _SPEED, _TURN))

    def _next(self, view: EnvView, index: int, plan: _Plan) -> np.ndarray:
        """Next position: the view itself, or a point on the centerline until the view is near."""
        if np.isnan(plan.arc_length):
            return plan.position
        left = plan.arc_length - view.arc_length[index]
        step = view.arc_length[index] + np.clip(left, -2.0 * CM, 2.0 * CM)
        return self._routes.of(view, index).poses(np.array([step]))[0, :3, 3]

    def _best(self, view: EnvView, index: int) -> _Plan:
        """Candidate with the most gain over time."""
        draw, route = self._draws[index], self._routes.of(view, index)
        T, now = view.T_world_capsule[index], float(view.arc_length[index])
        points, arc_length, way = _proposals(draw, route, T[:3, 3], now)
        points, arc_length, way = (
            np.repeat(part, _NUM_HEADINGS, axis=0) for part in (points, arc_length, way)
        )
        headings = unit(draw.normal(size=points.shape))
        is_free = route.is_free(points, headings)
        turning = np.arccos(np.clip(headings @ T[:3, 2], -1.0, 1.0)) / _TURN
        # The capsule turns on the way.
        time = np.maximum(way / _SPEED, turning) + _PAUSE
        gain = _gains(view, index, draw, points, headings)
        best = int(np.argmax(np.where(is_free, gain / time, -1.0)))
        start = float(view.time[index])
        until = start + 1.5 * float(time[best]) + _PAUSE
        return _Plan(points[best], headings[best], float(arc_length[best]), start, until)


def _is_over(view: EnvView, index: int, plan: _Plan) -> bool:
    """Return whether a view is reached, takes too long, or the capsule is stuck on the way."""
    T, now = view.T_world_capsule[index], view.time[index]
    speeds = np.linalg.norm(view.velocity_world[index], axis=1)
    is_held = now > plan.start + _PAUSE and bool((speeds < _STILL).all())
    off = heading_error(T[None, :3, :3], plan.heading[None])[0]
    is_there = np.linalg.norm(T[:3, 3] - plan.position) < _AT and np.linalg.norm(off) < _ALIGNED
    return bool(is_there or is_held or now > plan.until)


def _proposals(
    draw: np.random.Generator, route: Route, start: Float[np.ndarray, " 3"], arc_length: float
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Candidate positions, their arc lengths (NaN for a straight path), and path lengths [m].

    Args:
        draw: Random generator.
        route: Route through the organ.
        start: Position of the capsule.
        arc_length: Its arc length along the centerline [m].
    """
    reach = _REACH * draw.random((_NUM_NEAR, 1))
    near = start + reach * unit(draw.normal(size=(_NUM_NEAR, 3)))
    near = np.concatenate([start[None], near[route.is_clear(start, near)]])
    along = np.clip(arc_length + np.concatenate([-_ALONG, _ALONG]), *route.ends)
    points = np.concatenate([near, route.poses(along)[:, :3, 3]])
    ways = [np.linalg.norm(near - start, axis=1), np.abs(along - arc_length)]
    return points, np.concatenate([np.full(len(near), np.nan), along]), np.concatenate(ways)


def _gains(
    view: EnvView,
    index: int,
    draw: np.random.Generator,
    points: Float[np.ndarray, "n 3"],
    headings: Float[np.ndarray, "n 3"],
) -> Float[np.ndarray, " n"]:
    """Fraction of the wall that each view would newly show, estimated on a subset of its points.

    Args:
        view: EnvView of the worlds.
        index: Index of the world.
        draw: Random generator for the subset of the wall's points.
        points: Positions of the capsule.
        headings: Directions of its front.
    """
    patient = view.patient(index)
    up = np.eye(3)[np.abs(headings).argmin(axis=1)]
    Ts_world_capsule = transform_from(look_along(headings, up), points)
    left_out = draw.random(len(patient.points)) > _SHARE
    flags = np.where(left_out, _ALL_SEEN, view.coverage.flags[index]).astype(np.uint8)
    copies, cells = [flags.copy() for _ in points], np.zeros((len(points), patient.num_cells))
    gain = np.zeros((len(points), len(POINT_LEVELS)))
    for camera in view.device.cameras:
        gain += mark_points(
            [patient.model.wall] * len(points),
            [patient.points] * len(points),
            camera,
            Ts_world_capsule @ camera.T_capsule_camera,
            copies,
            cells,
            view.criteria,
        )
    level = getattr(view.task, "level", "visible")
    return gain[:, POINT_LEVELS.index(level)]
