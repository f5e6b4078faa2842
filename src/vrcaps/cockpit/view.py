"""View: what the page shows of one instant of the simulation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Float

    from vrcaps.world.model import State


@dataclass(frozen=True)
class View:
    """The simulation at one instant.

    Attributes:
        number: Counts the views of a session, so that none is drawn twice.
        frame: Number of the last whole frame.
        state: The world.
        T_world_patient: How the patient lies.
        T_world_magnet: Pose of the magnet.
        T_world_requested: Pose that the magnet was asked for.
        joint_angles: Of the arm [rad]; empty without one.
        limit: What keeps the magnet from the requested pose, see `ActuatorState`.
        lost: Why the magnet does not hold the capsule, see `ControllerStatus`.
        achieved_speed: Simulated time per real time; 0 while paused.
        is_paused: Whether time stands.
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
