"""Feedback controller that steers a capsule through the pose of an actuated magnet."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Protocol

import numpy as np

from vrcaps import _core
from vrcaps.actuation.capsule_target import CapsuleTarget
from vrcaps.actuation.magnet_actuator import ActuatorState, MagnetActuator
from vrcaps.actuation.magnet_pose_solver import MagnetPoseSolver, WrenchTarget
from vrcaps.core.errors import InputError
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.geometry import clamp_norm, detour, length, rotate_by_vector
from vrcaps.core.units import CM, DEG, MM
from vrcaps.magnet.field import SourceSet
from vrcaps.magnet.sources import Dipole, Magnet, Source
from vrcaps.world.control import GRAVITY, Control
from vrcaps.world.model import Model

if TYPE_CHECKING:
    from jaxtyping import Float

_POSITIVE = Range(above=0.0, below=math.inf)
_NOT_NEGATIVE = Range(min=0.0, below=math.inf)
_CONTROLLED_WEIGHT = 200.0 * np.eye(3)
"""Weight of a force error in a controlled direction [1/N]."""
_OTHER_WEIGHT = 40.0 * np.eye(3)
"""Weight of a force error in any other direction [1/N]."""
_TORQUE_WEIGHT = 4000.0
"""Weight of a torque error [1/(N·m)]: 0.25 mN·m weigh as much as 5 mN in a controlled direction."""
_MISALIGNED = 60.0 * DEG
"""Angle between moment and field beyond which the capsule is lost."""
_FOLLOWED_SPEED, _SLIDING_SPEED = 2.0 * CM, 4.0 * CM
"""Speeds [m/s] of full and of zero feedback: a magnet that lags a swing would amplify it."""
_SLIDING_DECAY = 0.3
"""Time constant with which the memory of a slide decays [s]."""
_FOLLOWS = 0.5
"""Distance from the reference, in lookaheads, within which a capsule follows."""
_LAGS = 0.9
"""Distance from the reference, in lookaheads, beyond which a capsule lags."""
_BLOCKED_LEAD = 5.0 * CM
"""Maximum lead [m] of the requested pose over a jogged magnet that is blocked."""
_MAX_PULL = 4.0
"""Maximum pull along the magnet's axis, in multiples of the supported force."""
_FIRST_ITERATIONS = 60
"""Maximum number of solver iterations for the first pose."""
_ITERATIONS = 8
"""Maximum number of solver iterations in a control step."""


@dataclass(frozen=True)
class ControllerGains:
    """Gains and limits of the controller that holds a capsule at a target.

    Across the capsule's axis the field acts as a spring of stiffness F/d, where F is the pull
    and d the distance of the magnet; along its axis the stiffness is three times as large.

    Attributes:
        upper_wall_force: Force with which the magnet presses the capsule against an upper wall [N].
        lower_wall_force: Force with which the capsule rests on a lower wall [N], below its weight.
        speed: Maximum speed of the reference that the capsule follows [m/s].
        angular_speed: Maximum angular speed of the reference direction [rad/s].
        lookahead: Maximum distance of the reference ahead of the capsule [m].
        lookahead_angle: Maximum angle of the reference direction ahead of the capsule's [rad].
        proportional_gain: Force per distance from the reference, relative to the field's stiffness.
        integral_gain: Force per distance and time, relative to the field's stiffness [1/s].
        damping_ratio: Force per velocity, relative to critical damping of the field's stiffness.
        max_force: Maximum force of these terms [N].
        torque_integral_gain: Torque per angle and time, relative to the field's torque [1/s].
        max_torque: Maximum torque of the integral term [N·m].
        timeout: Time after which a capsule that does not follow is considered stalled [s].
    """

    upper_wall_force: Annotated[float, _NOT_NEGATIVE] = 0.3
    lower_wall_force: Annotated[float, _NOT_NEGATIVE] = 0.05
    speed: Annotated[float, _POSITIVE] = 1.0 * CM
    angular_speed: Annotated[float, _POSITIVE] = 0.5
    lookahead: Annotated[float, _POSITIVE] = 5.0 * MM
    lookahead_angle: Annotated[float, _POSITIVE] = 20.0 * DEG
    proportional_gain: Annotated[float, _NOT_NEGATIVE] = 2.0
    integral_gain: Annotated[float, _NOT_NEGATIVE] = 3.0
    damping_ratio: Annotated[float, _NOT_NEGATIVE] = 1.0
    max_force: Annotated[float, _NOT_NEGATIVE] = 0.5
    torque_integral_gain: Annotated[float, _NOT_NEGATIVE] = 1.0
    max_torque: Annotated[float, _NOT_NEGATIVE] = 0.02
    timeout: Annotated[float, _POSITIVE] = 2.0

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True)
class ControllerStatus:
    """Actuator state, control errors and forces after the last command.

    Attributes:
        actuator: State of the magnet actuator.
        position_error: Offset from the capsule to the reference, in the controlled directions [m].
        heading_error: Angle between the target direction and the capsule's [rad].
        required_force: Force that the capsule needs [N], in the world.
        predicted_force: Force of the magnet at its requested pose on a capsule at the reference
            [N].
        lost: Reason why the magnet has lost the capsule, or empty. `misaligned`: the angle between
            moment and field is too large; `wrong_wall`: the capsule lies on another wall than the
            target's; `insufficient_force`: the magnet cannot reach a pose of sufficient force;
            `stalled`: the capsule does not follow.
    """

    actuator: ActuatorState
    position_error: Float[np.ndarray, " 3"]
    heading_error: float
    required_force: Float[np.ndarray, " 3"]
    predicted_force: Float[np.ndarray, " 3"]
    lost: str = ""


class CapsuleView(Protocol):
    """Capsule state known to a controller: from a `World` or estimated by a `CapsuleTracker`."""

    @property
    def T_world_capsule(self) -> Float[np.ndarray, "4 4"]:
        """Pose of the capsule."""
        ...

    @property
    def velocity_world(self) -> Float[np.ndarray, "2 3"]:
        """Velocity of the capsule's origin [m/s] and angular velocity [rad/s]."""
        ...

    @property
    def contact_force_world(self) -> Float[np.ndarray, " 3"]:
        """Force of the wall on the capsule [N]."""
        ...

    def field_angle(self, T_world_capsule: Float[np.ndarray, "4 4"]) -> float:
        """Angle between the moment of a capsule at a pose and the sources' field there [rad]."""
        ...


class MagnetController:
    """Controller that steers one capsule with one magnet, with its state."""

    def __init__(
        self,
        model: Model,
        magnet: Magnet | Dipole,
        actuator: MagnetActuator,
        T_world_capsule: Float[np.ndarray, "4 4"],
        target: CapsuleTarget,
        *,
        gains: ControllerGains | None = None,
        direction: Sequence[float] = (0.0, 0.0, 1.0),
        others: Sequence[Source] = (),
    ) -> None:
        """Move the magnet to the capsule.

        Args:
            model: Organ and device.
            magnet: The magnet; the controller chooses its pose.
            actuator: Actuator of the magnet.
            T_world_capsule: Pose of the capsule.
            target: First target of the capsule.
            gains: Gains; None for the defaults.
            direction: Direction from the capsule to the magnet's first position, in the world.
            others: Fixed sources, such as the earth's field.

        Raises:
            InputError: If the device has no magnet, or the actuator cannot hold the magnet at its
                first pose.
        """
        self.model = model
        self.actuator = actuator
        self.gains = gains or ControllerGains()
        sources = SourceSet([magnet, *others])
        self._solver = MagnetPoseSolver(sources, model.device.magnets, actuator.workspace)
        self._magnet = magnet
        self._others = tuple(others)
        self._weight = np.array([0.0, 0.0, model.device.mass * GRAVITY])
        normal = np.asarray(target.wall_normal, float)
        force = self._weight + self._wall_force(target) * normal
        wrench = WrenchTarget(force.tolist())
        away = np.asarray(direction, float)
        start = self._solver.initial_guess(T_world_capsule, away, length(force))
        solution = self._solver.solve(
            wrench, T_world_capsule, start, max_iterations=_FIRST_ITERATIONS
        )
        self._requested = solution.T_world_magnet
        self._max_torque = solution.max_torque
        state = actuator.start(self._requested)
        # Reference position, reference direction, and normal of the wall under the capsule.
        self._reference = np.array([T_world_capsule[:3, 3], T_world_capsule[:3, 2], normal])
        self._integral = np.zeros((2, 3))
        self._stall_time = 0.0
        self._sliding_speed = 0.0
        self.status = ControllerStatus(
            state, np.zeros(3), 0.0, np.array(wrench.force), solution.force
        )

    @property
    def sources(self) -> list[Source]:
        """The magnet at its current pose and the other sources, as a `World` expects them."""
        moved = replace(self._magnet, T_world_magnet=self.status.actuator.T_world_magnet)
        return [moved, *self._others]

    @property
    def requested(self) -> Float[np.ndarray, "4 4"]:
        """Last `T_world_magnet` requested from the actuator."""
        return self._requested

    def track(self, capsule: CapsuleView, target: CapsuleTarget, dt: float) -> Control:
        """Command for the next `dt` [s] that moves the capsule to a target and holds it there.

        The requested magnet pose exerts the force of the control law, including the supported
        weight, and the integrated torque on a capsule at the reference. Away from the reference the
        field itself holds the capsule, faster than any control loop.
        """
        T = capsule.T_world_capsule
        self._reference, T_reference, error, rotation, angle, is_on_wrong_wall = (
            _core.advance_reference(
                self._reference, T, capsule.contact_force_world, target, self.gains, dt
            )
        )
        supported = self._weight + self._wall_force(target) * self._reference[2]
        force = self._control_law(capsule, target, supported, error, dt)
        torque = self._integrate_torque(self._max_torque * rotation, dt)
        axes = target.controlled_axes
        weights = _OTHER_WEIGHT + (_CONTROLLED_WEIGHT - _OTHER_WEIGHT) * axes
        wrench = WrenchTarget(force.tolist(), torque.tolist(), weights.tolist(), _TORQUE_WEIGHT)
        solution = self._solver.solve(
            wrench, T_reference, self._requested, max_iterations=_ITERATIONS
        )
        self._requested = solution.T_world_magnet
        self._max_torque = solution.max_torque
        state = self.actuator.move(
            self.status.actuator, self._around_capsule(T, length(supported)), dt
        )
        self._update_stall_time(length(error) / self.gains.lookahead, dt)
        missing = length(axes @ (force - solution.force))
        lost = self._why_lost(
            capsule.field_angle(T),
            is_on_wrong_wall=is_on_wrong_wall,
            is_weak=missing > 0.01 + 0.25 * length(force),
        )
        self.status = ControllerStatus(state, error, angle, force, solution.force, lost)
        return self._command(state)

    def jog(
        self,
        linear: Sequence[float],
        angular: Sequence[float],
        dt: float,
        *,
        speed: float,
        angular_speed: float,
    ) -> Control:
        """Command for the next `dt` [s] that moves the magnet by joystick axes.

        Args:
            linear: Axes −1 to 1 that move the magnet along the world's x, y, z.
            angular: Axes −1 to 1 that rotate it about these axes.
            dt: Duration [s].
            speed: Speed at a full axis [m/s].
            angular_speed: Angular speed at a full axis [rad/s].

        Raises:
            InputError: If an axis is not from −1 to 1.
        """
        axes = np.array([*linear, *angular], float)
        if axes.shape != (6,) or not (np.abs(axes) <= 1.0).all():
            raise InputError(f"Joystick axes are {axes}. Allowed: six numbers from -1 to 1.")
        pose = self._requested.copy()
        pose[:3, 3] += speed * dt * axes[:3]
        pose[:3, :3] = rotate_by_vector(angular_speed * dt * axes[3:], pose[:3, :3])
        requested = self.actuator.workspace.clamp_pose(pose)
        state = self.actuator.move(self.status.actuator, requested, dt)
        if state.limit in ("unreachable", "collision"):
            at = state.T_world_magnet[:3, 3]
            requested[:3, 3] = at + clamp_norm(requested[:3, 3] - at, _BLOCKED_LEAD)
        self._requested = requested
        self.status = replace(self.status, actuator=state)
        return self._command(state)

    def update_status(self, capsule: CapsuleView) -> None:
        """Update `status.lost` of a jogged capsule after a step of the world."""
        lost = self._why_lost(capsule.field_angle(capsule.T_world_capsule))
        self.status = replace(self.status, lost=lost)

    def to_array(self) -> Float[np.ndarray, " q"]:
        """Complete state of the controller, for `restore`."""
        state = self.status.actuator
        parts = [state.T_world_magnet, state.velocity, state.joint_angles]
        parts += [self._requested, self._reference, self._integral]
        parts += [np.array([self._max_torque, self._stall_time, self._sliding_speed])]
        return np.concatenate([np.ravel(part) for part in parts])

    def restore(self, saved: Float[np.ndarray, " q"]) -> None:
        """Restore the state given by `to_array`."""
        state = self.status.actuator
        moving = (state.velocity.shape, state.joint_angles.shape)
        shapes = [(4, 4), *moving, (4, 4), (3, 3), (2, 3), (3,)]
        ends = np.cumsum([math.prod(shape) for shape in shapes])
        pieces = [
            part.reshape(shape).copy()
            for part, shape in zip(np.split(saved, ends[:-1]), shapes, strict=True)
        ]
        restored = ActuatorState(pieces[0], pieces[1], pieces[2])
        self.status = replace(self.status, actuator=restored)
        self._requested, self._reference, self._integral = pieces[3:6]
        self._max_torque, self._stall_time, self._sliding_speed = map(float, pieces[6])

    def _command(self, state: ActuatorState) -> Control:
        others = [other.T_world_magnet for other in self._others]
        return Control(Ts_world_magnet=np.array([state.T_world_magnet, *others]))

    def _around_capsule(
        self, T_world_capsule: Float[np.ndarray, "4 4"], supported: float
    ) -> Float[np.ndarray, "4 4"]:
        """Requested pose, or a detour that does not attract the capsule off its wall.

        At most twice the supported force [N] is requested, and from any side the magnet pulls with
        at least half its axial force. This limits how close it needs to be.
        """
        solver = self._solver
        radius = max(solver.max_distance(_MAX_PULL * supported), solver.workspace.min_distance)
        pose = self._requested.copy()
        now = self.status.actuator.T_world_magnet
        pose[:3, 3] = detour(now[:3, 3], pose[:3, 3], T_world_capsule[:3, 3], radius)
        return pose

    def _wall_force(self, target: CapsuleTarget) -> float:
        """Force between capsule and wall [N], by the side of the target's wall."""
        is_upper = target.wall_normal[2] >= 0.0
        return self.gains.upper_wall_force if is_upper else self.gains.lower_wall_force

    def _activity(self, speed: float, dt: float) -> float:
        """Fraction of the feedback for a capsule that is sliding or has recently slid."""
        decayed = self._sliding_speed * (1.0 - dt / _SLIDING_DECAY)
        self._sliding_speed = max(speed, decayed)
        left = (_SLIDING_SPEED - self._sliding_speed) / (_SLIDING_SPEED - _FOLLOWED_SPEED)
        return min(1.0, max(0.0, left))

    def _update_stall_time(self, lag: float, dt: float) -> None:
        """Accumulate the time without following; following partly reduces it."""
        if lag < _FOLLOWS:
            self._stall_time = 0.0
        else:
            self._stall_time = max(0.0, self._stall_time + (dt if lag > _LAGS else -dt))

    def _control_law(
        self,
        capsule: CapsuleView,
        target: CapsuleTarget,
        supported: Float[np.ndarray, " 3"],
        error: Float[np.ndarray, " 3"],
        dt: float,
    ) -> Float[np.ndarray, " 3"]:
        """Required force [N]: supported force and feedback of the position error [m]."""
        gains = self.gains
        T = capsule.T_world_capsule
        stiffness = max(length(supported), 0.05) / math.dist(T[:3, 3], self._requested[:3, 3])
        offset = clamp_norm(error, gains.lookahead)
        pull = stiffness * (offset + 2.0 * float(offset @ T[:3, 2]) * T[:3, 2])
        damping = 2.0 * gains.damping_ratio * math.sqrt(stiffness * self.model.device.mass)
        velocity = target.controlled_axes @ capsule.velocity_world[0]
        activity = self._activity(length(velocity), dt)
        self._integral[0] = clamp_norm(
            self._integral[0] + gains.integral_gain * dt * (activity * pull), gains.max_force
        )
        feedback = activity * (gains.proportional_gain * pull - damping * velocity)
        # A force beyond the supported force would need large movements of the magnet.
        limit = min(gains.max_force, length(supported))
        return clamp_norm(feedback + self._integral[0], limit) + supported

    def _integrate_torque(
        self, torque: Float[np.ndarray, " 3"], dt: float
    ) -> Float[np.ndarray, " 3"]:
        """Integral term of the torque [N·m], within its limit."""
        gains = self.gains
        self._integral[1] = clamp_norm(
            self._integral[1] + gains.torque_integral_gain * dt * torque, gains.max_torque
        )
        return self._integral[1]

    def _why_lost(
        self, angle: float, *, is_on_wrong_wall: bool = False, is_weak: bool = False
    ) -> str:
        """Reason why the magnet has lost the capsule, see `ControllerStatus`."""
        if angle > _MISALIGNED:
            return "misaligned"
        if is_on_wrong_wall:
            return "wrong_wall"
        if is_weak:
            return "insufficient_force"
        return "stalled" if self._stall_time > self.gains.timeout else ""
