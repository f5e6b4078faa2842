"""Dynamics: capsule motion simulated from gravity, wall contact, muscle and commands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from vrcaps.motion.dynamics_settings import DynamicsSettings
from vrcaps.motion.rollout import Rollout

if TYPE_CHECKING:
    from vrcaps.world.model import Model


@dataclass(frozen=True)
class Dynamics(DynamicsSettings):
    """Capsule motion simulated from gravity, wall contact, muscle and commands.

    The capsule is placed on the centerline and settles for `settle`; then time is 0 and the first
    frame is taken.

    Example:
        >>> motion = vrcaps.Dynamics(start=0.3, motility="phase-three", substep=2e-4)
        >>> vrcaps.record(vrcaps.Scenario("small-bowel", motion=motion), "runs/transit")

    Attributes: See `DynamicsSettings`.
    """

    def begin(
        self, model: Model, *, frames: int, fps: float, seed: int, shown: Model | None = None
    ) -> Rollout:
        """Start the simulation in a model, see `MotionSettings.begin`."""
        organ = None if shown is None or shown is model else shown.organ
        return Rollout(model, self, frames=frames, fps=fps, seed=seed, shown=organ)
