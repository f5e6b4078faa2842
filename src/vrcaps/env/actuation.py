"""Actuations: a wrench on the capsule, a free external magnet, and a robot arm with a magnet."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np

from vrcaps.actuation.arm.arm import Arm, arm_of, forward, jacobian, read_arm
from vrcaps.actuation.arm.arm_with_payload import (
    ArmWithPayload,
    clearances,
    magnet_pose_at,
    transverse_mount,
)
from vrcaps.actuation.magnet_actuator import RobotActuator
from vrcaps.actuation.magnet_pose_solver import MagnetPoseSolver, Workspace, WrenchTarget
from vrcaps.actuation.steering_program import BASE_BELOW, base_beside, workspace_above
from vrcaps.core.errors import InputError, require
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.geometry import rotation_from_vector
from vrcaps.core.units import CM
from vrcaps.env.parts import Actuation, EnvView
from vrcaps.magnet.field import SourceSet
from vrcaps.magnet.presets import magnet_of, read_magnet
from vrcaps.magnet.sources import Block, Cylinder, Magnet, Ring, Sphere
from vrcaps.world.control import GRAVITY, Control

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.magnet.sources import Source
    from vrcaps.world.model import Model, State

_DIRECTIONS = np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)])


def _axis_names(**units: str) -> tuple[str, ...]:
    """Names of vectors' components, with the value of an action of 1 in brackets."""
    return tuple(f"{name}_{axis} [{unit}]" for name, unit in units.items() for axis in "xyz")


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

    @property
    def names(self) -> tuple[str, ...]:
        """Force and torque along each axis, or the choice."""
        if self.mode == "discrete":
            return (f"choice [{self.force:g} N]",)
        return _axis_names(force=f"{self.force:g} N", torque=f"{self.torque:g} N·m")

    def controls(
        self, view: EnvView, actions: np.ndarray, indices: np.ndarray
    ) -> Sequence[Control]:
        """Return the wrench, constant for the control period."""
        if self.mode == "discrete":
            forces = self.force * _DIRECTIONS[actions[indices]]
            torques = np.zeros_like(forces)
        else:
            scaled = np.asarray(actions, float)[indices]
            forces, torques = self.force * scaled[:, :3], self.torque * scaled[:, 3:]
        if self.frame == "capsule":
            R = view.T_world_capsule[indices, :3, :3]
            forces, torques = (np.einsum("nij,nj->ni", R, v) for v in (forces, torques))
        if self.is_weightless:
            forces = forces + np.array([0.0, 0.0, view.device.mass * GRAVITY])
        return [Control(force, torque) for force, torque in zip(forces, torques, strict=True)]


_REMAINING_WEIGHT = 0.05
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
        magnet: Name of the magnet, see `vrcaps.magnet.presets.magnet_names`, path of its TOML file,
            or a magnet in memory, whose pose is ignored.
        speed: Maximum speed along each axis [m/s].
        angular_speed: Maximum angular speed about each axis [rad/s].
        standoff: Minimum gap between the organ's highest point and the magnet [m].
        reach: Margin of the box around the organ on all sides, and its height [m].
    """

    magnet: str | Cylinder | Ring | Block | Sphere = "cylinder-76.2"
    speed: Annotated[float, Range(above=0.0, max=1.0, unit="m/s")] = 5.0 * CM
    angular_speed: Annotated[float, Range(above=0.0, max=10.0, unit="rad/s")] = 1.0
    standoff: Annotated[float, Range(above=0.0, max=1.0, unit="m")] = 4.0 * CM
    reach: Annotated[float, Range(above=0.0, max=1.0, unit="m")] = 20.0 * CM

    kind: ClassVar[str] = "magnet"

    def __post_init__(self) -> None:
        check_fields(self)
        object.__setattr__(self, "magnet", magnet_of(self.magnet))

    def space(self) -> Any:
        """Action space: six values from −1 to 1."""
        from gymnasium import spaces

        return spaces.Box(-1.0, 1.0, (6,), np.float32)

    @property
    def names(self) -> tuple[str, ...]:
        """Velocity and angular velocity along each axis."""
        turn = f"{self.angular_speed:g} rad/s"
        return _axis_names(velocity=f"{self.speed:g} m/s", angular_velocity=turn)

    def allocate(self, view: EnvView) -> None:
        """Allocate the magnet's pose and its box."""
        view.memory.allocate("magnet/T", (4, 4))
        view.memory.allocate("magnet/box", (2, 3))

    def begin(self, view: EnvView, index: int, start: State) -> tuple[Source, ...]:
        """Place the magnet above the capsule.

        Raises:
            InputError: If the capsule contains no magnet.
        """
        model, magnet = view.patient(index).model, read_magnet(self.magnet)
        floor, vertices = workspace_above(model, magnet, self.standoff), model.vertices_world
        box = np.array([vertices.min(axis=0) - self.reach, vertices.max(axis=0) + self.reach])
        box[:, 2] = floor.low[2], floor.low[2] + self.reach
        (x0, y0, z0), (x1, y1, z1) = box.tolist()
        workspace = Workspace((x0, y0, z0), (x1, y1, z1), floor.min_distance)
        T_world_magnet = supporting_pose(model, magnet, workspace, start.T_world_capsule)
        view.memory["magnet/T"][index] = T_world_magnet
        view.memory["magnet/box"][index] = box
        return (read_magnet(self.magnet, T_world_magnet),)

    def controls(
        self, view: EnvView, actions: np.ndarray, indices: np.ndarray
    ) -> Sequence[Control]:
        """Move the magnet for a control period, within its box."""
        dt, poses = view.control_period, view.memory["magnet/T"]
        twist = np.asarray(actions, float)[indices]
        moved = poses[indices]
        low, high = np.moveaxis(view.memory["magnet/box"][indices], 1, 0)
        moved[:, :3, 3] = np.clip(moved[:, :3, 3] + self.speed * dt * twist[:, :3], low, high)
        turn = rotation_from_vector(self.angular_speed * dt * twist[:, 3:])
        moved[:, :3, :3] = turn @ moved[:, :3, :3]
        poses[indices] = moved
        return [Control(Ts_world_magnet=pose[None]) for pose in moved]


_REACH = 1.0
"""Positions of an arm's magnet are searched up to this distance along each axis [m]."""

_LEVER, _DAMPING, _CENTERING = 0.1, 0.02, 0.1
"""Weight of a rotation of the magnet against its motion [m], damping [m], and the rate at which
redundant joints move to the middle of their ranges [1/s], of `ArmActuation.towards`."""

_LIMIT_NAMES = np.array(["", "joint", "collision"], object)
"""Limits that may have modified the arm's motion, by the value of `arm/limit`."""


@dataclass(frozen=True)
class ArmActuation(Actuation):
    """A robot arm next to the patient that holds a magnet across its flange.

    An action has a value from −1 to 1 for each joint: its velocity, relative to `fraction` of its
    limit. A joint stops at the end of its range. The arm stops before a self-collision, and before
    its links or its magnet come below `standoff` above the organ's highest point: the plane of the
    patient and the table. `info["arm_limit"]` is then `joint` or `collision`.

    Attributes:
        arm: Name of the arm, path of its TOML or URDF file, or an arm in memory.
        magnet: Name of the magnet, see `vrcaps.magnet.presets.magnet_names`, path of its TOML file,
            or a magnet in memory, whose pose is ignored.
        fraction: Maximum velocity of each joint, as a fraction of its limit.
        standoff: Minimum gap between the organ's highest point and the magnet [m].
    """

    arm: str | Arm = "panda"
    magnet: str | Cylinder | Ring | Block | Sphere = "cylinder-76.2"
    fraction: Annotated[float, Range(above=0.0, max=1.0)] = 0.1
    standoff: Annotated[float, Range(above=0.0, max=1.0, unit="m")] = 4.0 * CM

    kind: ClassVar[str] = "arm"

    def __post_init__(self) -> None:
        check_fields(self)
        object.__setattr__(self, "magnet", magnet_of(self.magnet))
        object.__setattr__(self, "arm", arm_of(self.arm))
        home = np.array([self._robot.arm.home])
        gap = float(clearances(self._robot, home).min())
        allowed = "one with which the arm at rest is above the patient and off itself"
        require(gap >= 0.0, "ArmActuation's standoff", f"{self.standoff:g} m", allowed)

    @cached_property
    def _actuator(self) -> RobotActuator:
        """The arm with its magnet above the plane of the patient, in the frame of its base."""
        magnet = read_magnet(self.magnet)
        plane = BASE_BELOW + self.standoff
        mount = transverse_mount(magnet)
        return RobotActuator(
            ArmWithPayload(read_arm(self.arm), magnet, np.eye(4), mount, table_height=plane)
        )

    @property
    def _robot(self) -> ArmWithPayload:
        return self._actuator.robot

    @cached_property
    def _ranges(self) -> tuple[Float[np.ndarray, " j"], ...]:
        """Minimum and maximum angles [rad], and maximum velocities [rad/s]."""
        arm = self._robot.arm
        velocity = np.array([joint.velocity for joint in arm.joints])
        return arm.lower, arm.upper, self.fraction * velocity

    @property
    def box(self) -> Float[np.ndarray, "2 3"]:
        """Minimum and maximum positions of the magnet, relative to the arm's base [m].

        The magnet's edge stays above the plane of the patient for any orientation.
        """
        edge = 0.5 * math.hypot(*self._robot.magnet.bounds)
        low = BASE_BELOW + self.standoff + edge
        return np.array([[-_REACH, -_REACH, low], [_REACH, _REACH, low + _REACH]])

    def space(self) -> Any:
        """Action space: a value from −1 to 1 for each joint."""
        from gymnasium import spaces

        return spaces.Box(-1.0, 1.0, (self._robot.arm.num_joints,), np.float32)

    @property
    def names(self) -> tuple[str, ...]:
        """Velocity of each joint."""
        velocities = enumerate(self._ranges[2], 1)
        return tuple(f"joint_{k}_velocity [{v:.4g} rad/s]" for k, v in velocities)

    def allocate(self, view: EnvView) -> None:
        """Allocate joint angles, the base's position, and the magnet's pose."""
        memory = view.memory
        memory.allocate("magnet/T", (4, 4))
        memory.allocate("arm/joints", (self._robot.arm.num_joints,))
        memory.allocate("arm/base", (3,))
        memory.allocate("arm/limit", dtype=np.int64)

    def begin(self, view: EnvView, index: int, start: State) -> tuple[Source, ...]:
        """Place the magnet above the capsule; the arm starts at home if that is out of reach.

        Raises:
            InputError: If the capsule contains no magnet.
        """
        model, memory = view.patient(index).model, view.memory
        magnet, base = self._robot.magnet, base_beside(model.vertices_world)
        # The magnet's edge stays above the plane for any orientation.
        edge = 0.5 * (math.hypot(*magnet.bounds) - magnet.bounds[0])
        workspace = workspace_above(model, magnet, self.standoff + edge)
        T_base_magnet = supporting_pose(model, magnet, workspace, start.T_world_capsule)
        T_base_magnet[:3, 3] -= base
        try:
            angles = self._actuator.start(T_base_magnet).joint_angles
        except InputError:  # out of reach
            angles = np.array(self._robot.arm.home)
        memory["arm/joints"][index] = angles
        memory["arm/base"][index] = base
        memory["arm/limit"][index] = 0
        memory["magnet/T"][index] = magnet_pose_at(self._robot, angles)
        memory["magnet/T"][index, :3, 3] += base
        return (read_magnet(self.magnet, memory["magnet/T"][index].copy()),)

    def controls(
        self, view: EnvView, actions: np.ndarray, indices: np.ndarray
    ) -> Sequence[Control]:
        """Move the arm for a control period, or stop it."""
        memory, (lower, upper, velocity) = view.memory, self._ranges
        now = memory["arm/joints"][indices]
        step = view.control_period * velocity
        wanted = now + step * np.asarray(actions, float)[indices]
        angles = np.clip(wanted, lower, upper)
        collides = clearances(self._robot, angles).min(axis=1) < 0.0
        memory["arm/limit"][indices] = np.where(collides, 2, (angles != wanted).any(axis=1))
        angles = np.where(collides[:, None], now, angles)
        memory["arm/joints"][indices] = angles
        poses = magnet_pose_at(self._robot, angles)
        poses[:, :3, 3] += memory["arm/base"][indices]
        memory["magnet/T"][indices] = poses
        return [Control(Ts_world_magnet=pose[None]) for pose in poses]

    def towards(
        self,
        angles: Float[np.ndarray, " j"],
        T_base_magnet: Float[np.ndarray, "4 4"],
        dt: float,
    ) -> Float[np.ndarray, " j"]:
        """Return the action that moves the magnet towards a pose, for any rotation about its axis.

        Damped least squares (Wampler, IEEE Trans. Syst. Man Cybern. 16, 1986) over position and
        moment; redundant joints move towards the middle of their ranges.

        Args:
            angles: Current joint angles [rad].
            T_base_magnet: Target pose in the frame of the arm's base.
            dt: Control period [s].
        """
        robot, (lower, upper, velocity) = self._robot, self._ranges
        now = magnet_pose_at(robot, angles)
        rows = jacobian(robot.arm, angles)
        lever = now[:3, 3] - forward(robot.arm, angles)[:3, 3]
        linear = rows[:3] + np.cross(rows[3:], lever, axis=0)
        across, axis, goal = now[:3, :2].T, now[:3, 2], T_base_magnet[:3, 2]
        turn = np.cross(axis, goal)
        sine = float(np.linalg.norm(turn))
        turn *= math.atan2(sine, float(axis @ goal)) / max(sine, 1e-9)
        rows = np.concatenate([linear, _LEVER * across @ rows[3:]])
        error = np.concatenate([T_base_magnet[:3, 3] - now[:3, 3], _LEVER * across @ turn])
        inverse = rows.T @ np.linalg.inv(rows @ rows.T + _DAMPING**2 * np.eye(5))
        spare = np.eye(len(angles)) - inverse @ rows
        wanted = inverse @ error + spare @ (_CENTERING * dt * (0.5 * (lower + upper) - angles))
        shares = wanted / (dt * velocity)
        return shares / max(1.0, float(np.abs(shares).max()))

    def measures(self, view: EnvView) -> dict[str, np.ndarray]:
        """Return the limit that modified each arm's motion."""
        return {"arm_limit": _LIMIT_NAMES[view.memory["arm/limit"]]}


def supporting_pose(
    model: Model,
    magnet: Magnet,
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
    force = max(model.device.mass * GRAVITY - _REMAINING_WEIGHT, 0.0)
    guess = solver.initial_guess(T_world_capsule, _UP, force)
    return solver.solve(WrenchTarget((0.0, 0.0, force)), T_world_capsule, guess).T_world_magnet
