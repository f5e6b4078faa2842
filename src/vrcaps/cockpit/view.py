"""View: data of one instant of the simulation for the page."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Float

    from vrcaps.world.model import State


@dataclass(frozen=True)
class View:
    """Simulation at one instant.

    Attributes:
        number: Counter of the session's views, so that none is drawn twice.
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
    """

    number: int
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
