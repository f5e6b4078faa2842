"""Steering a capsule by one magnet, held by anything: goals, joystick, rolling."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from vrcaps._core import lead_on
from vrcaps.actuation.capsule_target import Goal
from vrcaps.actuation.magnet_actuator import Held, Holder
from vrcaps.actuation.magnet_pose_solver import Aim, Wish
from vrcaps.actuation.vectors import at_most, length, past, turned
from vrcaps.errors import InputError, require
from vrcaps.magnet.field import SourceSet
from vrcaps.magnet.sources import Cylinder, Dipole, Source
from vrcaps.units import CM, DEG, MM
from vrcaps.world.control import Control
from vrcaps.world.model import Model
from vrcaps.world.world import GRAVITY, World

if TYPE_CHECKING:
    from jaxtyping import Float

_CONTROLLED = 200.0 * np.eye(3)
"""What a newton counts in a direction that is controlled [1/N]: 5 mN count as much as…"""
_OTHER = 40.0 * np.eye(3)
"""…25 mN in another direction, and…"""
_TORQUE = 4000.0
"""…0.25 mN·m [1/(N·m)]."""
_LOST_ANGLE = 60.0 * DEG
_SLOW, _CALM = 4.0 * CM, 0.3
"""A capsule that slides faster than this [m/s] is left to the field until it has been calm for a
time [s]: the magnet, slower than the slide, would only stir it."""
_NEAR, _BEHIND = 0.5, 0.9
"""Distance from the leading point, in leads, within which the capsule follows, and beyond which…"""
_MOST = 4.0
"""Most pull along the magnet's axis, by the force that is borne."""
_FIRST_ROUNDS, _ROUNDS = 60, 8


@dataclass(frozen=True)
class Steering:
    """Gains of the loop that holds a capsule at a goal.

    Attributes:
        press: Force with which the magnet presses the capsule against an upper wall [N]. Sideways
            the field then holds it like a spring: by the force by the distance of the magnet across
            the capsule's axis, by three times that along it.
        rest: Force with which the capsule is left to rest on a lower wall [N], below its weight.
        speed: Largest speed of the point that the capsule is led by [m/s].
        turn_speed: Largest angular speed of the direction that it is led by [rad/s].
        lead: How far that point goes ahead of the capsule [m].
        turn_lead: How far that direction goes ahead of the capsule's [rad].
        stiffening: Force by distance from it, as a share of that spring's.
        rate: Force by distance and time, as a share of that spring's force a second [1/s].
        damping: Force by velocity, as a share of the spring's critical damping.
        most_force: Most that all these come to [N].
        turn_rate: Torque by angle and time, as a share of the field's own torque [1/s].
        most_torque: Most that it comes to [N·m].
        patience: Time after which a capsule that does not follow counts as lost [s].
    """

    press: float = 0.3
    rest: float = 0.05
    speed: float = 1.0 * CM
    turn_speed: float = 0.5
    lead: float = 5.0 * MM
    turn_lead: float = 20.0 * DEG
    stiffening: float = 2.0
    rate: float = 3.0
    damping: float = 1.0
    most_force: float = 0.5
    turn_rate: float = 1.0
    most_torque: float = 0.02
    patience: float = 2.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            positive = name in ("speed", "turn_speed", "lead", "turn_lead", "patience")
            allowed = "above 0" if positive else "0 or more"
            valid = 0.0 < value < math.inf if positive else 0.0 <= value < math.inf
            require(valid, f"Steering's {name}", value, allowed)


@dataclass(frozen=True)
class Steered:
    """How it goes.

    Attributes:
        held: The magnet.
        error: From the point that leads the capsule to the capsule, where it is controlled [m].
        angle: Between the direction wanted and the capsule's [rad].
        needed: Force that the capsule needs [N], in the world.
        offered: Force of the magnet asked for on a capsule where it should be [N].
        lost: Why the magnet has lost the capsule: nothing; `turned`: the moment is far off the
            field; `other-wall`: the capsule lies on another wall than it is to be pressed against;
            `weak`: the magnet cannot be where its force would be enough; `stuck`: the capsule does
            not follow.
    """

    held: Held
    error: Float[np.ndarray, " 3"]
    angle: float
    needed: Float[np.ndarray, " 3"]
    offered: Float[np.ndarray, " 3"]
    lost: str = ""


class Pilot:
    """Steers one capsule with one magnet; keeps where it is and what the loop has learnt."""

    def __init__(
        self,
        model: Model,
        magnet: Cylinder | Dipole,
        holder: Holder,
        T_world_capsule: Float[np.ndarray, "4 4"],
        goal: Goal,
        *,
        steering: Steering | None = None,
        direction: Sequence[float] = (0.0, 0.0, 1.0),
        others: Sequence[Source] = (),
    ) -> None:
        """Takes the magnet to the capsule.

        Args:
            model: Organ and device.
            magnet: The magnet; its pose is chosen.
            holder: What holds it.
            T_world_capsule: Where the capsule is.
            goal: Where it is to be first.
            steering: Gains; the defaults if None.
            direction: From the capsule to where the magnet is to begin with, in the world.
            others: Sources that stay where they are, such as the earth's.

        Raises:
            InputError: If the device holds no magnet, or the magnet cannot be held where it begins.
        """
        self.model, self.holder = model, holder
        self.steering = steering or Steering()
        self._aim = Aim(SourceSet([magnet, *others]), model.device.magnets, holder.room)
        self._magnet, self._others = magnet, tuple(others)
        self._weight = np.array([0.0, 0.0, model.device.mass * GRAVITY])
        press, away = np.asarray(goal.press, float), np.asarray(direction, float)
        force = self._weight + self._pressed(goal) * press
        wish = Wish(force.tolist())
        start = self._aim.guess(T_world_capsule, away, length(force))
        aimed = self._aim.solve(wish, T_world_capsule, start, rounds=_FIRST_ROUNDS)
        self._wanted, self._hold = aimed.T_world_magnet, aimed.hold
        held = holder.start(self._wanted)
        # Where it leads the capsule, where that is to look, and to the wall that it lies on.
        self._leader = np.array([T_world_capsule[:3, 3], T_world_capsule[:3, 2], press])
        self._learnt = np.zeros((2, 3))
        self._late = self._stir = 0.0
        self.steered = Steered(held, np.zeros(3), 0.0, np.array(wish.force), aimed.force)

    @property
    def sources(self) -> list[Source]:
        """The magnet where it is now and the others, as a `World` takes them."""
        moved = replace(self._magnet, T_world_magnet=self.steered.held.T_world_magnet)
        return [moved, *self._others]

    def hold(self, world: World, goal: Goal, dt: float) -> Control:
        """Command for the next `dt` [s] that leads the capsule to a goal and holds it there.

        The magnet is put where, for a capsule at the leading point, its force is that of the loop
        and of the weight, and its torque what the loop has learnt: away from that point the
        capsule is held by the field itself, faster than any loop.
        """
        s, T, free = self.steering, world.T_world_capsule, goal.controlled
        self._leader, led, error, bend, angle, fallen = lead_on(
            self._leader, T, world.contact_force_world, goal, s, dt
        )
        borne = self._weight + self._pressed(goal) * self._leader[2]
        soft = max(length(borne), 0.05) / math.dist(T[:3, 3], self._wanted[:3, 3])
        near = at_most(error, s.lead)
        pull = soft * (near + 2.0 * float(near @ T[:3, 2]) * T[:3, 2])
        self._late = self._lateness(length(error) / s.lead, dt)
        damping = 2.0 * s.damping * math.sqrt(soft * self.model.device.mass)
        velocity = free @ world.velocity_world[0]
        calm = self._calmness(length(velocity), dt)
        force, torque = self._learn(calm * pull, self._hold * bend, dt)
        pushed = calm * (s.stiffening * pull - damping * velocity)
        # More than it bears the magnet could do only by going far to and fro.
        needed = at_most(pushed + force, min(s.most_force, length(borne))) + borne
        weights = _OTHER + (_CONTROLLED - _OTHER) * free
        wish = Wish(needed.tolist(), torque.tolist(), weights.tolist(), _TORQUE)
        aimed = self._aim.solve(wish, led, self._wanted, rounds=_ROUNDS)
        self._wanted, self._hold = aimed.T_world_magnet, aimed.hold
        held = self.holder.move(self.steered.held, self._clear(T, length(borne)), dt)
        short = length(free @ (needed - aimed.force))
        weak = short > 0.01 + 0.25 * length(needed)
        lost = self._lost(world.field_angle(T), fallen=fallen, weak=weak)
        self.steered = Steered(held, error, angle, needed, aimed.force, lost)
        return self._command(held)

    def drive(
        self, move: Sequence[float], turn: Sequence[float], dt: float, *, speed: float, rate: float
    ) -> Control:
        """Command of a joystick for the next `dt` [s].

        Args:
            move: Axes −1 to 1 that move the magnet along the world's x, y, z.
            turn: Axes −1 to 1 that turn it about them.
            dt: How long.
            speed: Speed of a full axis [m/s].
            rate: Angular speed of a full axis [rad/s].

        Raises:
            InputError: If an axis is not from −1 to 1.
        """
        axes = np.array([*move, *turn], float)
        if axes.shape != (6,) or not (np.abs(axes) <= 1.0).all():
            raise InputError(f"Joystick axes {axes}. Allowed: six numbers from -1 to 1.")
        wanted = self._wanted.copy()
        wanted[:3, 3] += speed * dt * axes[:3]
        wanted[:3, :3] = turned(rate * dt * axes[3:], wanted[:3, :3])
        return self._go(self.holder.room.admit(wanted), dt)

    def rotate(self, axis: Sequence[float], rate: float, dt: float) -> Control:
        """Command that turns the magnet where it is: a capsule that can rolls or tumbles along.

        Args:
            axis: In the world; need not be of unit length.
            rate: [rad/s].
            dt: How long [s].
        """
        wanted = self._wanted.copy()
        unit = np.asarray(axis, float) / np.linalg.norm(axis)
        wanted[:3, :3] = turned(rate * dt * unit, wanted[:3, :3])
        return self._go(wanted, dt)

    def judge(self, world: World) -> None:
        """Says after a step whether a capsule that is driven by hand is lost."""
        lost = self._lost(world.field_angle(world.T_world_capsule))
        self.steered = replace(self.steered, lost=lost)

    def to_array(self) -> Float[np.ndarray, " q"]:
        """All that changes, for `restore`."""
        held = self.steered.held
        parts = (held.T_world_magnet, held.velocity, held.angles, self._wanted, self._leader)
        flat = (np.ravel(part) for part in (*parts, self._learnt))
        return np.concatenate([*flat, [self._hold, self._late, self._stir]])

    def restore(self, saved: Float[np.ndarray, " q"]) -> None:
        """Goes back to what `to_array` gave."""
        held = self.steered.held
        moving = (held.velocity.shape, held.angles.shape)
        shapes = [(4, 4), *moving, (4, 4), (3, 3), (2, 3), (3,)]
        ends = np.cumsum([math.prod(shape) for shape in shapes])
        pieces = [
            part.reshape(shape).copy()
            for part, shape in zip(np.split(saved, ends[:-1]), shapes, strict=True)
        ]
        self.steered = replace(self.steered, held=Held(pieces[0], pieces[1], pieces[2]))
        self._wanted, self._leader, self._learnt = pieces[3:6]
        self._hold, self._late, self._stir = map(float, pieces[6])

    def _go(self, wanted: Float[np.ndarray, "4 4"], dt: float) -> Control:
        held = self.holder.move(self.steered.held, wanted, dt)
        # What it cannot follow is not asked of it later.
        self._wanted = held.T_world_magnet if held.limit in ("reach", "touch") else wanted
        self.steered = replace(self.steered, held=held)
        return self._command(held)

    def _command(self, held: Held) -> Control:
        others = [other.T_world_magnet for other in self._others]
        return Control(Ts_world_magnet=np.array([held.T_world_magnet, *others]))

    def _clear(
        self, T_world_capsule: Float[np.ndarray, "4 4"], borne: float
    ) -> Float[np.ndarray, "4 4"]:
        """The pose wanted, or one on the way there that does not draw the capsule up to itself.

        At most twice the force that is borne [N] is asked for, and from any side the magnet can
        pull with half of what it can along its axis: no nearer than for that it need be.
        """
        apart = max(self._aim.farthest(_MOST * borne), self._aim.room.apart)
        clear, held = self._wanted.copy(), self.steered.held.T_world_magnet
        clear[:3, 3] = past(held[:3, 3], clear[:3, 3], T_world_capsule[:3, 3], apart)
        return clear

    def _pressed(self, goal: Goal) -> float:
        """Force between capsule and wall [N], on the wall at the goal's side."""
        return self.steering.press if goal.press[2] >= 0.0 else self.steering.rest

    def _calmness(self, speed: float, dt: float) -> float:
        """Share of the loop that acts on a capsule that slides, or did so a moment ago."""
        self._stir = max(speed, self._stir * (1.0 - dt / _CALM))
        return min(1.0, _SLOW / max(self._stir, 1e-9)) ** 2

    def _lateness(self, behind: float, dt: float) -> float:
        """Time for which the capsule has not followed [s]; to and fro counts for its part."""
        if behind < _NEAR:
            return 0.0
        return max(0.0, self._late + (dt if behind > _BEHIND else -dt))

    def _learn(
        self, force: Float[np.ndarray, " 3"], torque: Float[np.ndarray, " 3"], dt: float
    ) -> Float[np.ndarray, "2 3"]:
        """Force and torque that the loop has found to be needed, from those of the field's own."""
        s = self.steering
        self._learnt[0] = at_most(self._learnt[0] + s.rate * dt * force, s.most_force)
        self._learnt[1] = at_most(self._learnt[1] + s.turn_rate * dt * torque, s.most_torque)
        return self._learnt

    def _lost(self, angle: float, *, fallen: bool = False, weak: bool = False) -> str:
        """Why the magnet has lost the capsule, see `Steered`."""
        if angle > _LOST_ANGLE:
            return "turned"
        if fallen:
            return "other-wall"
        late = self._late > self.steering.patience
        return "weak" if weak else "stuck" if late else ""
