"""Magnet actuation: the twist of an external magnet that moves freely."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np

from vrcaps.actuation.magnet_pose_solver import MagnetPoseSolver, Workspace, WrenchTarget
from vrcaps.actuation.steering_program import workspace_above
from vrcaps.config.limits import Range, check_fields
from vrcaps.core.transforms import rotation_from_vector
from vrcaps.core.units import CM
from vrcaps.env.actuation.actuation import Actuation
from vrcaps.magnet.field import SourceSet
from vrcaps.magnet.presets import read_magnet
from vrcaps.world.control import GRAVITY, Control

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.env.simulation import Simulation
    from vrcaps.magnet.sources import Cylinder, Source
    from vrcaps.world.model import Model, State

_REST = 0.05
"""Force with which a supported capsule still rests on the wall below it [N]."""
_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class MagnetActuation(Actuation):
    """A magnet above the patient that follows velocity commands.

    An action has six values from −1 to 1: velocity along x, y and z of the world and angular
    velocity about them, relative to their maxima. The magnet starts above the capsule, where it
    supports most of its weight. It stays in a box that starts `standoff` above the organ's highest
    point.

    Attributes:
        magnet: Name of the magnet, see `vrcaps.magnet.presets.magnet_names`.
        speed: Maximum speed along each axis [m/s].
        angular_speed: Maximum angular speed about each axis [rad/s].
        standoff: Minimum gap between the organ's highest point and the magnet [m].
        reach: Margin of the box around the organ on all sides, and its height [m].
    """

    magnet: str = "cylinder-76.2"
    speed: Annotated[float, Range(above=0.0, max=1.0, unit="m/s")] = 5.0 * CM
    angular_speed: Annotated[float, Range(above=0.0, max=10.0, unit="rad/s")] = 1.0
    standoff: Annotated[float, Range(above=0.0, max=1.0, unit="m")] = 4.0 * CM
    reach: Annotated[float, Range(above=0.0, max=1.0, unit="m")] = 20.0 * CM

    kind: ClassVar[str] = "magnet"

    def __post_init__(self) -> None:
        check_fields(self)
        read_magnet(self.magnet)

    def space(self) -> Any:
        """Action space: six values from −1 to 1."""
        from gymnasium import spaces

        return spaces.Box(-1.0, 1.0, (6,), np.float32)

    def allocate(self, simulation: Simulation) -> None:
        """Allocate the magnet's pose and its box."""
        simulation.memory.allocate("magnet/T", (4, 4))
        simulation.memory.allocate("magnet/box", (2, 3))

    def begin(self, simulation: Simulation, index: int, start: State) -> tuple[Source, ...]:
        """Place the magnet above the capsule.

        Raises:
            InputError: If the capsule contains no magnet.
        """
        model, magnet = simulation.patient(index).model, read_magnet(self.magnet)
        floor, vertices = workspace_above(model, magnet, self.standoff), model.vertices_world
        box = np.array([vertices.min(axis=0) - self.reach, vertices.max(axis=0) + self.reach])
        box[:, 2] = floor.low[2], floor.low[2] + self.reach
        (x0, y0, z0), (x1, y1, z1) = box.tolist()
        workspace = Workspace((x0, y0, z0), (x1, y1, z1), floor.min_distance)
        T_world_magnet = supporting_pose(model, magnet, workspace, start.T_world_capsule)
        simulation.memory["magnet/T"][index] = T_world_magnet
        simulation.memory["magnet/box"][index] = box
        return (read_magnet(self.magnet, T_world_magnet),)

    def controls(
        self, simulation: Simulation, actions: np.ndarray, numbers: np.ndarray
    ) -> Sequence[Control]:
        """Move the magnet for a control period, within its box."""
        dt, poses = simulation.settings.control_period, simulation.memory["magnet/T"]
        twist = np.asarray(actions, float)[numbers]
        moved = poses[numbers]
        low, high = np.moveaxis(simulation.memory["magnet/box"][numbers], 1, 0)
        moved[:, :3, 3] = np.clip(moved[:, :3, 3] + self.speed * dt * twist[:, :3], low, high)
        turn = rotation_from_vector(self.angular_speed * dt * twist[:, 3:])
        moved[:, :3, :3] = turn @ moved[:, :3, :3]
        poses[numbers] = moved
        return [Control(Ts_world_magnet=pose[None]) for pose in moved]


def supporting_pose(
    model: Model,
    magnet: Cylinder,
    workspace: Workspace,
    T_world_capsule: Float[np.ndarray, "4 4"],
) -> Float[np.ndarray, "4 4"]:
    """Pose of a magnet that supports all but a small part of a capsule's weight.

    Args:
        model: The capsule and the organ.
        magnet: The magnet.
        workspace: Allowed positions of the magnet.
        T_world_capsule: Pose of the capsule; the field preserves its heading.

    Raises:
        InputError: If the capsule contains no magnet.
    """
    solver = MagnetPoseSolver(SourceSet([magnet]), model.device.magnets, workspace)
    force = max(model.device.mass * GRAVITY - _REST, 0.0)
    guess = solver.initial_guess(T_world_capsule, _UP, force)
    return solver.solve(WrenchTarget((0.0, 0.0, force)), T_world_capsule, guess).T_world_magnet
