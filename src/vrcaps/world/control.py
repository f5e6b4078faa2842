"""What is commanded while the world steps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.errors import InputError

if TYPE_CHECKING:
    from jaxtyping import Float

_ZERO = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Control:
    """Commands that hold during one step.

    Attributes:
        force_world: Force on the capsule's centre of mass [N].
        torque_world: Torque on the capsule [N·m].
        T_world_patient: How the patient lies at the end of the step; None leaves it as it is.
            Only gravity's direction follows: patients turn slowly.
        insufflation: Factor on the lumen's radius at the end of the step, 1 = as modelled.
    """

    force_world: tuple[float, float, float] | Float[np.ndarray, " 3"] = _ZERO
    torque_world: tuple[float, float, float] | Float[np.ndarray, " 3"] = _ZERO
    T_world_patient: Float[np.ndarray, "4 4"] | None = None
    insufflation: float = 1.0

    def __post_init__(self) -> None:
        for name in ("force_world", "torque_world", "T_world_patient", "insufflation"):
            value = getattr(self, name)
            if value is not None and not np.isfinite(value).all():
                raise InputError(f"Control's {name} is {value}. Allowed: finite numbers.")
        if not 0.2 <= self.insufflation <= 2.0:
            raise InputError(f"Control's insufflation is {self.insufflation}. Allowed: 0.2 to 2.")
