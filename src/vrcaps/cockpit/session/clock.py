"""Clock that paces simulated time, and `View`, the published state at one instant."""

from __future__ import annotations

import math
import threading
import time as wall_clock
from dataclasses import dataclass
from typing import TYPE_CHECKING

from vrcaps.core.errors import require

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Float

    from vrcaps.actuation.coil_program import CoilStatus
    from vrcaps.world.model import State

SLOWEST, FASTEST = 0.05, 4.0
"""Range of simulated time per real time."""

_LATE = 0.25
"""Delay [s] of the simulation above which lost time is not caught up."""

_MEMORY = 1.0
"""Real time [s] over which the achieved speed is measured."""


class Clock:
    """Pacing and pausing of the simulation.

    Attributes:
        achieved: Measured simulated time per real time; below `speed` if the machine is too
            slow.
    """

    def __init__(self, speed: float = 1.0) -> None:
        self.achieved = 0.0
        self._speed = speed
        self._until = math.inf
        self._anchor: tuple[float, float] | None = None
        self._measured = (0.0, 0.0)
        self._changed = threading.Condition()
        self._is_woken = False

    @property
    def speed(self) -> float:
        """Requested simulated time per real time."""
        return self._speed

    @speed.setter
    def speed(self, speed: float) -> None:
        allowed = f"{SLOWEST:g} to {FASTEST:g}"
        require(SLOWEST <= speed <= FASTEST, "speed", speed, allowed)
        with self._changed:
            self._speed, self._anchor = speed, None

    @property
    def is_paused(self) -> bool:
        """True if the simulation is paused, or will be after the steps that were requested."""
        return self._until < math.inf

    def holds(self, time: float) -> bool:
        """True if the simulation has to stop at a time [s]."""
        return time >= self._until

    def run(self, until: float = math.inf) -> None:
        """Let the simulation run until a time [s], by default without limit."""
        with self._changed:
            self._until, self._anchor = until, None
            self._changed.notify_all()

    def pause(self) -> None:
        """Stop the simulation after the current step."""
        self.run(-math.inf)

    def wake(self) -> None:
        """End the current `wait`, so that the simulation can process other commands."""
        with self._changed:
            self._anchor, self._is_woken = None, True
            self._changed.notify_all()

    def wait(self, time: float) -> None:
        """Block until the simulation, now at a time [s], may continue, or `wake` is called."""
        with self._changed:
            while self.holds(time) and not self._is_woken:
                self.achieved, self._anchor = 0.0, None
                self._changed.wait()
            if self._is_woken:
                self._is_woken = False
                return
            now = wall_clock.perf_counter()
            if self._anchor is None:
                self._anchor = self._measured = (now, time)
            due = self._anchor[0] + (time - self._anchor[1]) / self._speed
            if now - due > _LATE:
                self._anchor = (now, time)
            elif due > now:
                self._changed.wait(due - now)
            self._measure(wall_clock.perf_counter(), time)

    def _measure(self, now: float, time: float) -> None:
        started, first = self._measured
        if now - started > _MEMORY:
            self.achieved = (time - first) / (now - started)
            self._measured = (now, time)


@dataclass(frozen=True)
class View:
    """Simulation at one instant.

    Attributes:
        index: Counter of the session's views, so that each is drawn once.
        frame: Index of the last completed frame.
        state: The world.
        T_world_patient: Posture of the patient.
        T_world_magnet: Pose of the magnet.
        T_world_requested: Requested pose of the magnet.
        joint_angles: Joint angles of the arm [rad]; empty without one.
        limit: Limit that keeps the magnet from the requested pose, see `ActuatorState`.
        lost: Why the magnet does not hold the capsule, see `ControllerStatus`.
        achieved_speed: Simulated time per real time; 0 while paused.
        is_paused: Whether the simulation is paused.
        coils: Currents and temperatures; None with a magnet, whose poses are those of the array
            otherwise.
    """

    index: int
    frame: int
    state: State
    T_world_patient: Float[np.ndarray, "4 4"]
    T_world_magnet: Float[np.ndarray, "4 4"]
    T_world_requested: Float[np.ndarray, "4 4"]
    joint_angles: Float[np.ndarray, " j"]
    limit: str
    lost: str
    achieved_speed: float
    is_paused: bool
    coils: CoilStatus | None = None
