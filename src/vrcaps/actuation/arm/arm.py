"""Robot arm: read by name or file; forward and inverse kinematics."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.actuation.arm.chain import Arm
from vrcaps.config.convert import from_plain
from vrcaps.config.plain_files import CatalogFolder, read_plain
from vrcaps.core.errors import InputError

if TYPE_CHECKING:
    from jaxtyping import Float


_ARMS = CatalogFolder(Path(__file__).parent / "arms", "arm")


def arm_names() -> tuple[str, ...]:
    """Names of the arms in the catalog, sorted."""
    return _ARMS.names()


def read_arm(given: str | Path | Arm) -> Arm:
    """Read an arm of the catalog by name, or a custom arm from its file; an `Arm` is unchanged.

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
        raise InputError(f"Unknown key {path.name}: name. The name of an arm is that of its file.")
    return from_plain(Arm, {"name": path.stem, **plain}, at=f"{path.name}:", units=True)


def _from_urdf(plain: dict[str, Any], path: Path) -> Arm:
    from vrcaps.actuation.arm.urdf import UrdfArm, arm_from_urdf

    settings = from_plain(UrdfArm, plain, at=f"{path.name}:", units=True)
    return arm_from_urdf(settings, name=path.stem)


def arm_of(given: str | Path | Arm) -> str | Arm:
    """Convert an arm's file to an object; names and arms are checked and returned unchanged.

    Settings apply it to their arm once, so that an episode contains the arm and not its path.

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
            f"Arm {arm.name} has no closed-form inverse kinematics, unlike the Panda. "
            "Use nearest(), which solves it iteratively."
        )


def _checked(arm: Arm, angles: np.ndarray) -> np.ndarray:
    angles = np.ascontiguousarray(angles, float)
    if angles.shape[-1:] != (arm.num_joints,) or not np.isfinite(angles).all():
        raise InputError(
            f"Angles for arm {arm.name} have shape {angles.shape}. "
            f"Allowed: {arm.num_joints} finite angles [rad] along the last axis."
        )
    return angles


def _poses(poses: np.ndarray) -> np.ndarray:
    poses = np.ascontiguousarray(poses, float)
    if poses.shape[-2:] != (4, 4) or not np.isfinite(poses).all():
        raise InputError(f"Poses have shape {poses.shape}. Allowed: finite 4 x 4 matrices.")
    return poses.reshape(-1, 4, 4)
