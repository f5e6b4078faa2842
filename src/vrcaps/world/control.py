"""Control: the commands that hold during one step of a `World`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.core.errors import InputError, require
from vrcaps.core.geometry import invert, rotate_vectors
from vrcaps.magnet.sources import check_pose

if TYPE_CHECKING:
    from jaxtyping import Float

_ZERO = (0.0, 0.0, 0.0)
_LONGEST_STEP = 1.0  # [s]
_STRONGEST_FORCE = 100.0  # [N]
_STRONGEST_TORQUE = 10.0  # [N·m]


@dataclass(frozen=True)
class Control:
    """Commands that hold during one step.

    Example:
        >>> world.step(vrcaps.Control(force_world=(0.0, 0.0, 0.02)), dt=0.01)

    Attributes:
        force_world: Force on the capsule's center of mass [N].
        torque_world: Torque on the capsule [N·m].
        T_world_patient: Posture of the patient at the end of the step; None leaves it unchanged.
            Only the directions of gravity and of sources follow: patients turn slowly.
        insufflation: Factor on the lumen's radius at the end of the step, 1 = as modeled.
        Ts_world_magnet: Poses of the world's sources at the end of the step, which they approach
            at constant velocity on a straight line and by the shortest rotation. None leaves them
            unchanged.
        strengths: Factor on the field of each source at the end of the step, such as the current
            of a coil relative to its stated one; None leaves them unchanged.
        flush: Progress of a rinse around the capsule at the end of the step: fraction, 0 to 1, of
            the bubbles and chyme there that are washed off by then.
    """

    force_world: tuple[float, float, float] | Float[np.ndarray, " 3"] = _ZERO
    torque_world: tuple[float, float, float] | Float[np.ndarray, " 3"] = _ZERO
    T_world_patient: Float[np.ndarray, "4 4"] | None = None
    insufflation: float = 1.0
    Ts_world_magnet: Float[np.ndarray, "k 4 4"] | None = None
    strengths: Float[np.ndarray, " k"] | None = None
    flush: float = 0.0

    def __post_init__(self) -> None:
        shapes = {"force_world": (3,), "torque_world": (3,), "T_world_patient": (4, 4)}
        for name in (*shapes, "insufflation", "flush"):
            value = getattr(self, name)
            if value is getattr(Control, name):  # its default
                continue
            if np.shape(value) != shapes.get(name, ()):
                raise InputError(
                    f"Control's {name} has the shape {np.shape(value)}. "
                    f"Allowed: {shapes.get(name, ())}."
                )
            if not _are_finite(value):
                given = " ".join(str(value).split())
                raise InputError(f"Control's {name} is {given}. Allowed: finite numbers.")
        if not 0.2 <= self.insufflation <= 2.0:
            raise InputError(f"Control's insufflation is {self.insufflation}. Allowed: 0.2 to 2.")
        require(0.0 <= self.flush <= 1.0, "Control's flush", self.flush, "0 to 1")
        self._check_sources()
        if self.T_world_patient is not None:
            turn = np.asarray(self.T_world_patient)[:3, :3]
            if not np.allclose(turn.T @ turn, np.eye(3), atol=1e-6) or np.linalg.det(turn) < 0.0:
                raise InputError("Control's T_world_patient stretches or mirrors. Allowed: a pose.")

    def _check_sources(self) -> None:
        if self.Ts_world_magnet is not None:
            is_list = hasattr(self.Ts_world_magnet, "__len__")
            require(is_list, "Control's Ts_world_magnet", self.Ts_world_magnet, "a list of poses")
            for T_world_magnet in self.Ts_world_magnet:
                check_pose("Control's Ts_world_magnet", T_world_magnet)
        if self.strengths is not None and not (
            np.ndim(self.strengths) == 1 and _are_finite(self.strengths)
        ):
            raise InputError(
                f"Control's strengths are {self.strengths}. Allowed: a finite number per source."
            )


def _are_finite(values: Any) -> bool:
    """Return whether all values are finite numbers."""
    array = np.asarray(values)
    return array.dtype.kind in "iuf" and bool(np.isfinite(array).all())


GRAVITY = 9.80665
"""Standard acceleration of gravity [m/s²] (CGPM 1901)."""


def check_steps(controls: Sequence[Control], dt: float) -> dict[int, str]:
    """Errors of controls that are too strong, by their index.

    Raises:
        InputError: If the step is too long.
    """
    require(0.0 < dt <= _LONGEST_STEP, "dt", dt, f"above 0 to {_LONGEST_STEP:g} s")
    failures: dict[int, str] = {}
    for name, most in (("force_world", _STRONGEST_FORCE), ("torque_world", _STRONGEST_TORQUE)):
        commands = np.array([getattr(control, name) for control in controls], float)
        strength = np.linalg.norm(commands.reshape(-1, 3), axis=1)
        for k in np.flatnonzero(~(strength <= most)).tolist():
            given = f"Control's {name} is {strength[k]:g} strong. Allowed: up to {most:g}."
            failures.setdefault(k, given)
    return failures


def loads_in_patient(
    controls: Sequence[Control], Ts_world_patient: Float[np.ndarray, "n 4 4"]
) -> Float[np.ndarray, "n 9"]:
    """Commanded forces [N] and torques [N·m], and gravity [m/s²], in the patient frame.

    Args:
        controls: The commands.
        Ts_world_patient: Pose of each patient; gravity is world −z.
    """
    down = (0.0, 0.0, -GRAVITY)
    loads = [(control.force_world, control.torque_world, down) for control in controls]
    to_patient = invert(Ts_world_patient)
    return rotate_vectors(to_patient, np.array(loads, float).reshape(-1, 3, 3)).reshape(-1, 9)
