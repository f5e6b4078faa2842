"""An arm as data: joints by Denavit and Hartenberg, limits, capsules around its links."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from vrcaps import _core
from vrcaps.errors import InputError


@dataclass(frozen=True)
class Joint:
    """A turning joint: ``T = Rot_x(alpha) Trans_x(a) Rot_z(theta + angle) Trans_z(d)``.

    This is Craig's convention (Introduction to Robotics, 1989, eq. 3.6), from the frame before it.

    Attributes:
        a: Length of the link before it [m].
        d: Offset along its axis [m].
        alpha: Twist of the link before it [rad].
        theta: Turn at angle 0 [rad].
        lower: Least angle [rad].
        upper: Largest angle [rad].
        velocity: Largest speed [rad/s].
        acceleration: Largest acceleration [rad/s²].
        jerk: Largest jerk [rad/s³].
        torque: Largest torque [N·m].
    """

    a: float
    d: float
    alpha: float
    theta: float
    lower: float
    upper: float
    velocity: float
    acceleration: float
    jerk: float
    torque: float


@dataclass(frozen=True)
class Link:
    """A capsule around part of a link.

    Attributes:
        frame: Frame it is fixed to: 0 the base, then the joints, last the flange.
        start: One end of its middle line, in that frame [m].
        end: The other end [m].
        radius: Radius [m].
    """

    frame: int
    start: tuple[float, float, float]
    end: tuple[float, float, float]
    radius: float


@dataclass(frozen=True)
class Arm:
    """An arm of turning joints. Frame `base` is where it is bolted down, `flange` its end.

    Attributes:
        name: Catalog name.
        title: Full name for people.
        joints: Joints from the base on.
        flange_offset: Origin of the flange in the last joint's frame [m]; the axes are the same.
        home: Angles of rest [rad].
        payload: Largest mass that it may carry [kg].
        links: Capsules around its links.
        collision_pairs: Pairs of frames whose links must not touch.
        source: Where the figures come from.
    """

    name: str
    title: str
    joints: tuple[Joint, ...]
    flange_offset: tuple[float, float, float]
    home: tuple[float, ...]
    payload: float
    links: tuple[Link, ...] = ()
    collision_pairs: tuple[tuple[int, int], ...] = ()
    source: str = field(default="", compare=False)

    def __post_init__(self) -> None:
        n = len(self.joints)
        for number, joint in enumerate(self.joints, start=1):
            limits = (joint.velocity, joint.acceleration, joint.jerk, joint.torque)
            if not (joint.lower < joint.upper and min(limits) > 0.0):
                raise InputError(
                    f"Arm {self.name}, joint {number}: angles {joint.lower:g} to {joint.upper:g} "
                    f"rad, other limits {limits}. Allowed: lower below upper, others above 0."
                )
        if n == 0 or len(self.home) != n:
            raise InputError(f"Arm {self.name}: {n} joints, {len(self.home)} home angles.")
        inside = [j.lower <= q <= j.upper for j, q in zip(self.joints, self.home, strict=True)]
        if not all(inside):
            raise InputError(
                f"Arm {self.name}: home angle of joint {inside.index(False) + 1} is outside its "
                "limits. Allowed: from lower to upper."
            )
        frames = [link.frame for link in self.links] + [
            f for pair in self.collision_pairs for f in pair
        ]
        if frames and not 0 <= min(frames) <= max(frames) <= n + 1:
            raise InputError(
                f"Arm {self.name}: a link or pair names frame {max(frames)} or {min(frames)}. "
                f"Allowed: 0 (base) to {n + 1} (flange)."
            )

    @property
    def num_joints(self) -> int:
        """How many joints there are."""
        return len(self.joints)

    @cached_property
    def lower(self) -> np.ndarray:
        """Least angles [rad]."""
        return np.array([joint.lower for joint in self.joints])

    @cached_property
    def upper(self) -> np.ndarray:
        """Largest angles [rad]."""
        return np.array([joint.upper for joint in self.joints])

    @cached_property
    def core(self) -> _core.ArmChain:
        """The compiled core's form of it."""
        joints = [[j.a, j.d, j.alpha, j.theta, j.lower, j.upper] for j in self.joints]
        flange = np.eye(4)
        flange[:3, 3] = self.flange_offset
        links = [[link.frame, *link.start, *link.end, link.radius] for link in self.links]
        pairs = [
            (i, j)
            for i, one in enumerate(self.links)
            for j, other in enumerate(self.links)
            if (one.frame, other.frame) in self.collision_pairs
        ]
        table = np.array(links, float).reshape(-1, 8)
        return _core.ArmChain(np.array(joints, float), flange, table, pairs)
