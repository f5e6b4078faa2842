"""Robot arm: Denavit-Hartenberg joints, limits, collisions, forward and inverse kinematics."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from vrcaps import _core
from vrcaps.config.convert import from_plain
from vrcaps.config.limits import Range, check_fields
from vrcaps.config.plain_files import CatalogFolder, read_plain
from vrcaps.core.errors import InputError, require
from vrcaps.magnet.pose import check_pose

if TYPE_CHECKING:
    from jaxtyping import Float


Vector = tuple[float, float, float]
Row = tuple[float, float, float, float]
Rows = tuple[Row, Row, Row]
"""First three rows of a pose."""


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

    def __post_init__(self) -> None:
        require(self.payload > 0.0, "payload", self.payload, "above 0 kg")
        n = len(self.joints)
        if n == 0 or len(self.home) != n:
            raise InputError(f"Arm {self.name}: {n} joints, {len(self.home)} home angles.")
        inside = [j.lower <= q <= j.upper for j, q in zip(self.joints, self.home, strict=True)]
        if not all(inside):
            raise InputError(
                f"Arm {self.name}: home angle of joint {inside.index(False) + 1} is outside its "
                "limits. Allowed: from lower to upper."
            )
        check_pose(f"flange of arm {self.name}", self.T_joint_flange)
        frames = [link.frame for link in self.links]
        frames += [f for pair in self.collision_pairs for f in pair]
        if frames and not 0 <= min(frames) <= max(frames) <= n + 1:
            raise InputError(
                f"Arm {self.name}: a link or pair names frame {max(frames)} or {min(frames)}. "
                f"Allowed: 0 (base) to {n + 1} (flange)."
            )

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


_ARMS = CatalogFolder(Path(__file__).parent / "arms", "arm")


def arm_names() -> tuple[str, ...]:
    """Names of the arms in the catalog, sorted."""
    return _ARMS.names()


def read_arm(given: str | Path | Arm) -> Arm:
    """Read an arm of the catalog by name, or a custom arm from its file; an arm is unchanged.

    A TOML file has the fields of `Arm` in the units of their keys (see `arms/panda.toml`), or the
    key `urdf` and the fields of `UrdfArm`; a URDF file is read with the defaults of `UrdfArm`. The
    name of the arm is that of the file.

    Raises:
        UnknownNameError: If the catalog has no arm with that name.
        InputError: If the file does not exist or is not TOML or URDF, a key is missing or unknown,
            a value is invalid, or the arm is impossible.
    """
    if isinstance(given, Arm):
        return given
    if not isinstance(given, str | Path):
        raise InputError(
            f"arm is of type {type(given).__name__}. Allowed: a name ({', '.join(arm_names())}), "
            "the path of a TOML or URDF file, or an Arm."
        )
    if Path(given).suffix == ".urdf":
        return _from_urdf({"urdf": str(given)}, Path(given))
    path = _ARMS.find(given)
    plain = read_plain(path, "arm")
    if isinstance(plain, dict) and "urdf" in plain:
        return _from_urdf({**plain, "urdf": str(path.parent / str(plain["urdf"]))}, path)
    if "name" in plain:
        raise InputError(f"Unknown key {path.name}: name. The arm is named as its file.")
    return from_plain(Arm, {"name": path.stem, **plain}, at=f"{path.name}:", units=True)


def _from_urdf(plain: dict[str, Any], path: Path) -> Arm:
    from vrcaps.actuation.arm.urdf import UrdfArm, arm_from_urdf

    settings = from_plain(UrdfArm, plain, at=f"{path.name}:", units=True)
    return arm_from_urdf(settings, name=path.stem)


def arm_of(given: str | Path | Arm) -> str | Arm:
    """Arm of a file as an object; names and arms are checked and unchanged.

    Settings convert their arm by it once, so that an episode contains it and not its path.

    Raises:
        UnknownNameError: If the catalog has no arm with that name.
        InputError: As in `read_arm`.
    """
    return str(given) if given in arm_names() else read_arm(given)


def forward(arm: Arm, angles: Float[np.ndarray, "*n j"]) -> Float[np.ndarray, "*n 4 4"]:
    """Pose ``T_base_flange`` at joint angles [rad]; angles may exceed the limits.

    Raises:
        InputError: If there is not one finite angle per joint.
    """
    angles = _checked(arm, angles)
    frames = arm.core.frames(angles.reshape(-1, arm.num_joints))
    return frames[:, -1].reshape(*angles.shape[:-1], 4, 4)


def frames(arm: Arm, angles: Float[np.ndarray, "*n j"]) -> Float[np.ndarray, "*n f 4 4"]:
    """Poses of all joint frames and the flange in the base frame, at joint angles [rad].

    Raises:
        InputError: If there is not one finite angle per joint.
    """
    angles = _checked(arm, angles)
    poses = arm.core.frames(angles.reshape(-1, arm.num_joints))
    return poses.reshape(*angles.shape[:-1], arm.num_joints + 1, 4, 4)


def jacobian(arm: Arm, angles: Float[np.ndarray, "*n j"]) -> Float[np.ndarray, "*n 6 j"]:
    """Jacobian of the flange in the base frame: its origin [m] and rotation [rad] per joint angle.

    Raises:
        InputError: If there is not one finite angle per joint.
    """
    angles = _checked(arm, angles)
    rows = arm.core.jacobian(angles.reshape(-1, arm.num_joints))
    return rows.reshape(*angles.shape[:-1], 6, arm.num_joints)


def inverse(
    arm: Arm, T_base_flange: Float[np.ndarray, "4 4"], last_angle: float
) -> Float[np.ndarray, "b j"]:
    """All angles within limits for a flange pose, with the last joint at `last_angle` [rad].

    Closed form with up to eight branches; empty if the pose cannot be reached.

    Raises:
        InputError: If the arm has no closed form (docs/concepts/magnets.md) or the pose is not
            finite.
    """
    _require_closed_form(arm)
    angles = arm.core.inverse(_poses(T_base_flange), [last_angle])[0]
    return angles[~np.isnan(angles[:, 0])]


def nearest(
    arm: Arm,
    T_base_flange: Float[np.ndarray, "*n 4 4"],
    near: Float[np.ndarray, "*n j"],
    *,
    rng: np.random.Generator | None = None,
) -> Float[np.ndarray, "*n j"]:
    """Angles within limits for flange poses, nearest to `near`; NaN where there are none.

    Nearest is Euclidean in the joint angles, over all branches and over the last joint's angle. An
    arm without a closed form is solved by damped least squares (Wampler 1986) from `near`, then
    from its home, then, given `rng`, from 30 random angles; the first solution is returned.

    Raises:
        InputError: If a pose or an angle is not finite.
    """
    targets = _poses(T_base_flange)
    batch = np.shape(T_base_flange)[:-2]
    start = np.broadcast_to(_checked(arm, near), (*batch, arm.num_joints))
    start = np.ascontiguousarray(start).reshape(-1, arm.num_joints)
    others = np.array([arm.home])
    if rng is not None:
        others = np.vstack([others, rng.uniform(arm.lower, arm.upper, (30, arm.num_joints))])
    return arm.core.nearest(targets, start, others).reshape(*batch, arm.num_joints)


def _require_closed_form(arm: Arm) -> None:
    if not arm.core.has_closed_form:
        raise InputError(
            f"Arm {arm.name} is not built like the Panda, so its inverse has no closed form here. "
            "Use nearest(), which solves it step by step."
        )


def _checked(arm: Arm, angles: np.ndarray) -> np.ndarray:
    angles = np.ascontiguousarray(angles, float)
    if angles.shape[-1:] != (arm.num_joints,) or not np.isfinite(angles).all():
        raise InputError(
            f"Angles of shape {angles.shape} for arm {arm.name}. "
            f"Allowed: {arm.num_joints} finite angles [rad], with batch axes before."
        )
    return angles


def _poses(poses: np.ndarray) -> np.ndarray:
    poses = np.ascontiguousarray(poses, float)
    if poses.shape[-2:] != (4, 4) or not np.isfinite(poses).all():
        raise InputError(f"Poses of shape {poses.shape}. Allowed: finite 4 x 4 matrices.")
    return poses.reshape(-1, 4, 4)
