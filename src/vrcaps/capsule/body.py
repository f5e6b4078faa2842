"""Rigid body of the capsule: a cylinder with round ends."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import require

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.capsule.device import Device


@dataclass(frozen=True)
class Body:
    """Mass properties and shape, in the capsule frame (origin at the center of mass).

    Attributes:
        mass: Mass [kg].
        inertia: Inertia about the center of mass [kg·m²], symmetric, positive definite.
        center: Center of the cylinder [m]; its axis is along z.
        half_axis: Half the length of the straight part [m].
        radius: Radius of the cylinder and of both ends [m].
    """

    mass: float
    inertia: Float[np.ndarray, "3 3"]
    center: Float[np.ndarray, " 3"]
    half_axis: float
    radius: float

    def __post_init__(self) -> None:
        require(0.0 < self.mass < np.inf, "mass", self.mass, "above 0 kg")
        moments = np.linalg.eigvalsh(self.inertia)
        # No body has a principal moment larger than the sum of the other two.
        physical = np.isfinite(moments).all() and moments[0] > 0.0
        physical = physical and moments[2] <= (moments[0] + moments[1]) * (1.0 + 1e-9)
        require(
            bool(physical and np.allclose(self.inertia, self.inertia.T, rtol=1e-9, atol=0.0)),
            "inertia",
            np.asarray(self.inertia).tolist(),
            "symmetric, positive, and no principal moment above the sum of the other two",
        )


def homogeneous_body(device: Device) -> Body:
    """Rigid body of a device with its mass distributed evenly over its volume.

    The inertia is that of a cylinder with two half balls; their centers of mass lie 3/8 of the
    radius beyond its ends (Goldstein, Classical Mechanics, 3rd ed., 5.3, and the parallel axis
    theorem).
    """
    radius, half = device.radius, device.length / 2.0 - device.radius
    cylinder, ball = np.pi * radius**2 * 2.0 * half, 4.0 / 3.0 * np.pi * radius**3
    density = device.mass / (cylinder + ball)
    along = cylinder * radius**2 / 2.0 + ball * 0.4 * radius**2
    across = cylinder * (radius**2 / 4.0 + half**2 / 3.0)
    across += ball * (0.4 * radius**2 + half**2 + 0.75 * half * radius)
    inertia = density * np.diag([across, across, along])
    return Body(device.mass, inertia, np.zeros(3), half, radius)
