"""Joystick axes that move a magnet to a pose."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.geometry import vector_from_rotation

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.actuation.steering_program import SteeringProgram

_ARRIVED = (1e-5, 1e-4)
"""Distance [m] and angle [rad] from a pose within which it counts as reached."""
_BLOCKED = ("unreachable", "collision")
"""Limits of the actuator at which it cannot come closer."""


def axes_towards(
    program: SteeringProgram, T_world_magnet: Float[np.ndarray, "4 4"], dt: float
) -> tuple[Float[np.ndarray, " 6"], bool]:
    """Axes −1 to 1 that move the requested pose of a magnet straight to another at maximum speed.

    Args:
        program: Program of the magnet.
        T_world_magnet: Pose to reach.
        dt: Duration of the command [s].

    Returns:
        The axes, and whether the pose is reached or the actuator cannot come closer.
    """
    settings, controller = program.settings, program.controller
    now, limit = controller.requested, controller.status.actuator.limit
    offset = T_world_magnet[:3, 3] - now[:3, 3]
    rotation = vector_from_rotation(T_world_magnet[:3, :3] @ now[:3, :3].T)
    is_near = np.linalg.norm(offset) < _ARRIVED[0] and np.linalg.norm(rotation) < _ARRIVED[1]
    full = np.repeat([settings.joystick_speed, settings.joystick_angular_speed], 3) * dt
    axes = np.concatenate([offset, rotation]) / full
    # All axes by the same factor, so that the path is straight.
    axes = axes / max(1.0, float(np.abs(axes).max()))
    return axes, bool(is_near) or limit in _BLOCKED
