"""Leads a capsule to a place on the wall near by, along the wall, anew where it is stuck."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.actuation.capsule_target import Goal, wall_goal
from vrcaps.actuation.magnet_controller import Pilot
from vrcaps.actuation.wall_path import Follower, straight_wall_path
from vrcaps.errors import require
from vrcaps.units import MM
from vrcaps.world.control import Control

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.world.world import World

_NEAR = 3.0 * MM
"""How far from the leading point, at the goal, a capsule may be."""
_SETTLED = 1.0
"""Time for which it must be as near [s]; one that has fallen for so long is fetched…"""
_GONE = 8.0
"""…for so long at most [s]."""


class Guide:
    """Leads one capsule to one goal; where it is stuck, a way is sought anew from there."""

    def __init__(
        self,
        pilot: Pilot,
        T_world_capsule: Float[np.ndarray, "4 4"],
        goal: Goal,
        *,
        avoid: Float[np.ndarray, " 3"] | None = None,
        tries: int = 2,
        patience: float = 10.0,
    ) -> None:
        """Plans the way.

        Args:
            pilot: Steers the capsule; its model is that of the organ at rest.
            T_world_capsule: Where the capsule lies on the wall.
            goal: Where it is to lie and look, see `wall_goal`; not far.
            avoid: Direction through which it cannot be turned, see `straight_wall_path`.
            tries: How often a way is planned, at least 1.
            patience: Time beyond that of the way after which a try has failed [s].

        Raises:
            InputError: If the goal has no direction, or there is no try.
        """
        require(tries >= 1, "tries", tries, "1 or more")
        self._pilot, self._goal, self._avoid = pilot, goal, avoid
        self.tries, self.patience = tries, patience
        self._still = self._gone = 0.0
        self._plan(T_world_capsule)

    @property
    def settled(self) -> bool:
        """Whether the capsule is at the goal, and has been for a second."""
        return self._still >= _SETTLED

    @property
    def failed(self) -> bool:
        """Whether time and tries are up, or the capsule has left the wall; see `Pilot.steered`."""
        over = self.tries == 0 and self._time > self._limit
        return not self.settled and (over or self._gone > _GONE)

    def control(self, world: World, dt: float) -> Control:
        """Command for the next `dt` [s]."""
        T = world.T_world_capsule
        if self._time > self._limit and self.tries:
            self._plan(T)
        goal = self._follower.goal(T, dt)
        # Off the map the magnet bears the capsule where it is, and so draws it back to its wall.
        goal = replace(goal, mapped=self._gone < _SETTLED)
        control = self._pilot.hold(world, goal, dt)
        self._time += dt
        off = float(np.linalg.norm(self._pilot.steered.error))
        gone = self._pilot.steered.lost == "other-wall"
        self._gone = self._gone + dt if gone else 0.0
        there = self._follower.arrived and off < _NEAR
        self._still = self._still + dt if there else 0.0
        return control

    def _plan(self, T_world_capsule: Float[np.ndarray, "4 4"]) -> None:
        model, steering = self._pilot.model, self._pilot.steering
        here = wall_goal(model, T_world_capsule[:3, 3], T_world_capsule[:3, 2])
        path = straight_wall_path(model, here, self._goal, avoid=self._avoid)
        self._follower = Follower(path, steering.speed, steering.lead)
        self._time, self._limit = 0.0, path.length / steering.speed + self.patience
        self.tries -= 1
