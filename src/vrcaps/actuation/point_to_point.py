"""Point-to-point planner: moves a capsule to a nearby pose on the wall, replans after a stall."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.actuation.capsule_target import CapsuleTarget, wall_target
from vrcaps.actuation.magnet_controller import CapsuleView, MagnetController
from vrcaps.actuation.wall_path import PathFollower, straight_wall_path
from vrcaps.core.errors import require
from vrcaps.core.units import MM
from vrcaps.world.control import Control

if TYPE_CHECKING:
    from jaxtyping import Float

_TOLERANCE = 3.0 * MM
"""Distance from the reference, at the target, within which a capsule has arrived."""
_SETTLING_TIME = 1.0
"""Time [s] for which a capsule must stay at the target. A capsule that is on another wall for this
long is brought back."""
_RECOVERY_TIMEOUT = 8.0
"""Maximum time [s] for bringing back a capsule from another wall."""


class PointToPointPlanner:
    """Planner that moves one capsule to one target, and replans where the capsule stalls."""

    def __init__(
        self,
        controller: MagnetController,
        T_world_capsule: Float[np.ndarray, "4 4"],
        target: CapsuleTarget,
        *,
        avoid: Float[np.ndarray, " 3"] | None = None,
        attempts: int = 2,
        timeout: float = 10.0,
    ) -> None:
        """Plan the path.

        Args:
            controller: Steers the capsule; its model is that of the organ at rest.
            T_world_capsule: Pose of the capsule, which lies on the wall.
            target: Nearby pose to reach, see `wall_target`.
            avoid: Direction that the capsule cannot pass through, see `straight_wall_path`.
            attempts: Maximum number of planned paths, 1 or more.
            timeout: Time in addition to that of the path after which an attempt has failed [s].

        Raises:
            InputError: If the target has no direction, or `attempts` is 0.
        """
        require(attempts >= 1, "attempts", attempts, "1 or more")
        self._controller = controller
        self._target = target
        self._avoid = avoid
        self.attempts = attempts
        self.timeout = timeout
        self._settled_time = 0.0
        self._off_wall_time = 0.0
        self._plan(T_world_capsule)

    @property
    def is_settled(self) -> bool:
        """Check that the capsule is at the target and has been for a second."""
        return self._settled_time >= _SETTLING_TIME

    @property
    def has_failed(self) -> bool:
        """Check for failure: no attempt left, or off the wall; see the controller's status."""
        is_over = self.attempts == 0 and self._time > self._limit
        return not self.is_settled and (is_over or self._off_wall_time > _RECOVERY_TIMEOUT)

    def control(self, capsule: CapsuleView, dt: float) -> Control:
        """Command for the next `dt` [s]."""
        T = capsule.T_world_capsule
        if self._time > self._limit and self.attempts:
            self._plan(T)
        target = self._follower.target(T, dt)
        # Off the planned wall, the magnet holds the capsule where it is, and so draws it back.
        target = replace(target, on_planned_wall=self._off_wall_time < _SETTLING_TIME)
        control = self._controller.track(capsule, target, dt)
        self._time += dt
        status = self._controller.status
        error = float(np.linalg.norm(status.position_error))
        is_off_wall = status.lost == "wrong_wall"
        self._off_wall_time = self._off_wall_time + dt if is_off_wall else 0.0
        is_there = self._follower.has_arrived and error < _TOLERANCE
        self._settled_time = self._settled_time + dt if is_there else 0.0
        return control

    def _plan(self, T_world_capsule: Float[np.ndarray, "4 4"]) -> None:
        model = self._controller.model
        gains = self._controller.gains
        here = wall_target(model, T_world_capsule[:3, 3], T_world_capsule[:3, 2])
        path = straight_wall_path(model, here, self._target, avoid=self._avoid)
        self._follower = PathFollower(path, gains.speed, gains.lookahead)
        self._time = 0.0
        self._limit = path.length / gains.speed + self.timeout
        self.attempts -= 1
