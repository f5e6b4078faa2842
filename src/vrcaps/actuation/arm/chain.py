"""Chain of an arm: its joints, links and limits, and its form in the compiled core."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Any

import numpy as np

from vrcaps import _core
from vrcaps.core.errors import InputError, require
from vrcaps.core.fields import Range, check_fields
from vrcaps.magnet.pose import check_pose

Vector = tuple[float, float, float]
Row = tuple[float, float, float, float]
Rows = tuple[Row, Row, Row]
"""First three rows of a pose."""
_GYRATION = 0.1
"""Radius of gyration of a link without a stated inertia [m]."""
_MOST = 1e6
"""Maximum mass [kg], coordinate of a center [m] and moment of inertia [kg·m²] of a link."""


def _in(unit: str, **options: Any) -> Any:
    """Field that files store in a unit."""
    return field(metadata={"unit": unit}, **options)


@dataclass(frozen=True)
class Joint:
    """Revolute joint: ``T = Rot_x(alpha) Trans_x(a) Rot_z(theta + angle) Trans_z(d)``.

    Uses Craig's convention (Introduction to Robotics, 1989, eq. 3.6), from the previous frame, or
    from a fixed placement in it. A joint of a URDF has a placement, and parameters of 0.

    Attributes:
        a: Length of the previous link [m].
        d: Offset along the joint axis [m].
        alpha: Twist of the previous link [rad].
        theta: Rotation at angle 0 [rad].
        lower: Lower limit of the angle [rad].
        upper: Upper limit of the angle [rad].
        velocity: Limit of the speed [rad/s].
        acceleration: Limit of the acceleration [rad/s²].
        jerk: Limit of the jerk [rad/s³].
        torque: Limit of the torque [N·m]; inf if unknown.
        placement: First three rows of the pose in the previous frame from which the parameters
            start [m]; None is that frame.
    """

    a: float = _in("mm")
    d: float = _in("mm")
    alpha: float = _in("deg")
    theta: float = _in("deg")
    lower: float = _in("rad")
    upper: float = _in("rad")
    velocity: Annotated[float, Range(above=0.0)] = _in("rad_per_s")
    acceleration: Annotated[float, Range(above=0.0)] = _in("rad_per_s2")
    jerk: Annotated[float, Range(above=0.0)] = _in("rad_per_s3")
    torque: float = _in("nm")
    placement: Rows | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        require(self.torque > 0.0, "torque", self.torque, "above 0")
        allowed = f"above lower, {self.lower:g} rad"
        require(self.lower < self.upper, "upper", f"{self.upper:g}", allowed)
        if self.placement is not None:
            check_pose("placement", np.array([*self.placement, (0.0, 0.0, 0.0, 1.0)], float))


@dataclass(frozen=True)
class Link:
    """Collision capsule around part of a link.

    Attributes:
        frame: Index of its frame: 0 for the base, then the joints, last the flange.
        start: One end of its axis, in that frame [m].
        end: The other end [m].
        radius: Radius [m].
    """

    frame: Annotated[int, Range(min=0)]
    start: tuple[float, float, float] = _in("mm")
    end: tuple[float, float, float] = _in("mm")
    radius: Annotated[float, Range(above=0.0)] = _in("mm")

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True)
class LinkMass:
    """Mass of the bodies fixed to a frame.

    Attributes:
        frame: Index of the frame: 0 for the base, then the joints, last the flange.
        mass: Mass [kg].
        center: Center of mass in that frame [m].
        inertia: Inertia about the center in the axes of the frame, xx, yy, zz, xy, xz, yz [kg·m²];
            None is a radius of gyration of 0.1 m, an assumption.
    """

    frame: Annotated[int, Range(min=0)]
    mass: Annotated[float, Range(above=0.0, max=_MOST)] = _in("kg")
    center: Vector = field(default=(0.0, 0.0, 0.0), metadata={"unit": "mm"})
    inertia: tuple[float, float, float, float, float, float] | None = field(
        default=None, metadata={"unit": "kg_m2"}
    )

    def __post_init__(self) -> None:
        check_fields(self)
        for name, values in (("center", self.center), ("inertia", self.tensor)):
            is_bounded = bool((np.abs(values) <= _MOST).all())
            require(is_bounded, name, getattr(self, name), f"numbers from {-_MOST:g} to {_MOST:g}")
        moments = np.linalg.eigvalsh(self.tensor)
        is_possible = moments[0] > 0.0 and moments[2] <= (moments[0] + moments[1]) * (1.0 + 1e-9)
        allowed = "positive, and no principal moment above the sum of the other two"
        require(bool(is_possible), "inertia", self.inertia, allowed)

    @property
    def tensor(self) -> np.ndarray:
        """Inertia about the center [3 3], in the axes of the frame [kg·m²]."""
        if self.inertia is None:
            return self.mass * _GYRATION**2 * np.eye(3)
        xx, yy, zz, xy, xz, yz = self.inertia
        return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


@dataclass(frozen=True)
class Arm:
    """Robot arm with revolute joints from frame `base` to its end, `flange`.

    Attributes:
        name: Catalog name.
        title: Display name.
        joints: Joints in order from the base.
        flange_offset: Origin of the flange in the last joint's frame [m].
        home: Home angles [rad].
        payload: Maximum payload mass [kg]; inf if unknown.
        links: Collision capsules around its links.
        collision_pairs: Pairs of frames whose links must not collide.
        source: Source of the parameters.
        flange_rotation: Rows of the rotation from the flange to the last joint's frame; None if the
            axes are the same.
        masses: Masses of links, one per frame; missing ones are unknown.
    """

    name: str
    title: str
    joints: tuple[Joint, ...]
    flange_offset: tuple[float, float, float] = _in("mm")
    home: tuple[float, ...] = _in("deg")
    payload: float = _in("kg")
    links: tuple[Link, ...] = ()
    collision_pairs: tuple[tuple[int, int], ...] = ()
    source: str = field(default="", compare=False)
    flange_rotation: tuple[Vector, Vector, Vector] | None = None
    masses: tuple[LinkMass, ...] = ()

    def __post_init__(self) -> None:
        require(self.payload > 0.0, "payload", self.payload, "above 0 kg")
        n = len(self.joints)
        if n == 0 or len(self.home) != n:
            raise InputError(f"Arm {self.name}has {n} joints, but {len(self.home)} home angles.")
        inside = [j.lower <= q <= j.upper for j, q in zip(self.joints, self.home, strict=True)]
        if not all(inside):
            raise InputError(
                f"Arm {self.name}: home angle of joint {inside.index(False) + 1} is outside its "
                "limits. Allowed: from lower to upper."
            )
        check_pose(f"flange of arm {self.name}", self.T_joint_flange)
        frames = [link.frame for link in (*self.links, *self.masses)]
        frames += [f for pair in self.collision_pairs for f in pair]
        if frames and not 0 <= min(frames) <= max(frames) <= n + 1:
            raise InputError(
                f"Arm {self.name}: a link, pair or mass names frame {max(frames)} or "
                f"{min(frames)}. Allowed: 0 (base) to {n + 1} (flange)."
            )
        if len({each.frame for each in self.masses}) < len(self.masses):
            raise InputError(f"Arm {self.name}: a frame has two masses. Allowed: one for a frame.")

    @property
    def num_joints(self) -> int:
        """Number of joints."""
        return len(self.joints)

    @cached_property
    def T_joint_flange(self) -> np.ndarray:
        """Pose of the flange in the last joint's frame."""
        pose = np.eye(4)
        pose[:3, 3] = self.flange_offset
        if self.flange_rotation is not None:
            pose[:3, :3] = self.flange_rotation
        return pose

    @cached_property
    def lower(self) -> np.ndarray:
        """Minimum angles [rad]."""
        return np.array([joint.lower for joint in self.joints])

    @cached_property
    def upper(self) -> np.ndarray:
        """Maximum angles [rad]."""
        return np.array([joint.upper for joint in self.joints])

    @cached_property
    def core(self) -> _core.ArmChain:
        """Arm in the form of the compiled core."""
        joints = [[j.a, j.d, j.alpha, j.theta, j.lower, j.upper] for j in self.joints]
        links = [[link.frame, *link.start, *link.end, link.radius] for link in self.links]
        pairs = [
            (i, j)
            for i, one in enumerate(self.links)
            for j, other in enumerate(self.links)
            if (one.frame, other.frame) in self.collision_pairs
        ]
        table = np.array(links, float).reshape(-1, 8)
        own, flange = np.array(joints, float), self.T_joint_flange
        if all(joint.placement is None for joint in self.joints):
            return _core.ArmChain(own, flange, table, pairs)
        placements = np.tile(np.eye(4), (self.num_joints, 1, 1))
        for pose, joint in zip(placements, self.joints, strict=True):
            pose[:3] = pose[:3] if joint.placement is None else joint.placement
        return _core.ArmChain(own, flange, table, pairs, placements)
