"""Start of an episode: the capsule's initial pose, drawn at each reset."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from vrcaps.config.limits import Range, check_fields
from vrcaps.core.errors import InputError
from vrcaps.motion.trajectory import start_pose
from vrcaps.world.model import Model, State


@dataclass(frozen=True)
class Start:
    """Initial pose of an episode; each value is drawn uniformly between its two limits.

    Attributes:
        fraction: Position along the centerline, as a fraction; moved to where the capsule fits.
        angle: Angle between the capsule's front and the direction to the anal end [rad].
        settle: Time for the capsule to come to rest before the first observation [s].
    """

    fraction: tuple[float, float] = (0.1, 0.9)
    angle: tuple[float, float] = (0.0, 0.0)
    settle: Annotated[float, Range(min=0.0, max=10.0, unit="s")] = 0.5

    def __post_init__(self) -> None:
        check_fields(self)
        low, high = self.fraction
        if not 0.0 <= low <= high <= 1.0:
            raise InputError(f"Start's fraction is {self.fraction}. Allowed: 0 to 1, rising.")
        if not all(map(math.isfinite, self.angle)) or self.angle[0] > self.angle[1]:
            raise InputError(f"Start's angle is {self.angle}. Allowed: finite [rad], rising.")

    def draw(self, model: Model, rng: np.random.Generator) -> tuple[State, float]:
        """Draw a state at rest; returns it and its arc length [m].

        Raises:
            InputError: If the capsule does not fit in the organ.
        """
        place, angle = (float(rng.uniform(*limits)) for limits in (self.fraction, self.angle))
        T_world_capsule, arc_length, _ = start_pose(model, place, angle)
        return State(0.0, T_world_capsule), arc_length
