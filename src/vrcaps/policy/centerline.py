"""Centerline policy: fly along the centerline to one end and then to the other, looking ahead."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.units import MM
from vrcaps.policy.policy import Requirements
from vrcaps.policy.route import Route, Routes
from vrcaps.policy.servo import SERVO_ACTUATIONS, Goal, servo_actions

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.env.simulation import Simulation
    from vrcaps.env.vector_env import CapsuleVectorEnv

_NEAR = 8.0 * MM
"""Distance from an end at which it counts as reached."""

_PATIENCE = 4.0
"""Time without progress after which the capsule turns back [s]."""


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

    def reset(self, numbers: np.ndarray, seeds: Sequence[int]) -> None:
        """Reset the progress of some worlds."""
        for number in np.asarray(numbers).tolist():
            self._walks[number] = Walk()

    def act(self, observations: dict[str, np.ndarray], env: CapsuleVectorEnv) -> np.ndarray:
        """Return actions towards the next position on the centerline."""
        simulation = env.episode.simulation
        goals = [self._goal(simulation, k) for k in range(env.num_envs)]
        position, heading = (np.stack(part) for part in zip(*goals, strict=True))
        return servo_actions(simulation, Goal(position, heading, self.speed))

    def _goal(self, simulation: Simulation, index: int) -> tuple[np.ndarray, np.ndarray]:
        """Position and heading of one capsule's goal."""
        route, walk = self._routes.of(simulation, index), self._walks[index]
        now, time = float(simulation.arc_length[index]), float(simulation.time[index])
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
