"""Wrench actuation: a force and a torque on the capsule, as by an ideal actuator."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np

from vrcaps.config.limits import Range, check_fields
from vrcaps.env.actuation.actuation import Actuation
from vrcaps.world.control import GRAVITY, Control

if TYPE_CHECKING:
    from vrcaps.env.simulation import Simulation

_DIRECTIONS = np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)])


@dataclass(frozen=True)
class Wrench(Actuation):
    """A force on the capsule's center of mass and a torque.

    `continuous` actions have six values from −1 to 1: force and torque, relative to their maxima.
    `discrete` actions are VR-Caps' set: 0 for no force, 1 to 3 for a force along x, y, z, 4 to 6
    for a force along −x, −y, −z, at full strength.

    Attributes:
        mode: Kind of the action space.
        force: Maximum force in each direction [N].
        torque: Maximum torque about each axis [N·m].
        is_weightless: Whether gravity is balanced, as by a magnet that holds the capsule up.
        frame: Axes of the actions: the world's, or the capsule's at the start of the action.
    """

    mode: Literal["continuous", "discrete"] = "continuous"
    force: Annotated[float, Range(min=0.0, max=2.0, unit="N")] = 0.02
    torque: Annotated[float, Range(min=0.0, max=0.05, unit="N·m")] = 1e-4
    is_weightless: bool = False
    frame: Literal["world", "capsule"] = "world"

    kind: ClassVar[str] = "wrench"

    def __post_init__(self) -> None:
        check_fields(self)

    def space(self) -> Any:
        """Action space: six values from −1 to 1, or one of seven choices."""
        from gymnasium import spaces

        if self.mode == "discrete":
            return spaces.Discrete(len(_DIRECTIONS))
        return spaces.Box(-1.0, 1.0, (6,), np.float32)

    def controls(
        self, simulation: Simulation, actions: np.ndarray, numbers: np.ndarray
    ) -> Sequence[Control]:
        """Return the wrench, constant for the control period."""
        if self.mode == "discrete":
            forces = self.force * _DIRECTIONS[actions[numbers]]
            torques = np.zeros_like(forces)
        else:
            scaled = np.asarray(actions, float)[numbers]
            forces, torques = self.force * scaled[:, :3], self.torque * scaled[:, 3:]
        if self.frame == "capsule":
            R = simulation.T_world_capsule[numbers, :3, :3]
            forces, torques = (np.einsum("nij,nj->ni", R, v) for v in (forces, torques))
        if self.is_weightless:
            forces = forces + np.array([0.0, 0.0, simulation.device.mass * GRAVITY])
        return [Control(force, torque) for force, torque in zip(forces, torques, strict=True)]
