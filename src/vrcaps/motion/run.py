"""A run of the capsule: what the world is like at each frame, one after another."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from vrcaps.world.model import State

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Float

    from vrcaps.actuation.magnet_controller import ControllerStatus


@dataclass(frozen=True)
class Conditions:
    """What the capsule was exposed to in a simulated frame.

    Attributes:
        force_world: Mean commanded force since the frame before [N].
        torque_world: Mean commanded torque since the frame before [N·m].
        insufflation: Factor on the lumen's radius now.
        T_world_patient: How the patient lies now.
        controller_status: State of the magnet controller; None without one.
        phase: Phase 1 to 4 of the migrating motor complex at the capsule; 0 where there is none.
    """

    force_world: Float[np.ndarray, " 3"]
    torque_world: Float[np.ndarray, " 3"]
    insufflation: float
    T_world_patient: Float[np.ndarray, "4 4"]
    phase: int
    controller_status: ControllerStatus | None = None


@dataclass(frozen=True)
class Instant:
    """One frame of a run.

    Attributes:
        state: The world; its contact is over the time since the frame before.
        conditions: What was commanded; None where nothing is simulated.
    """

    state: State
    conditions: Conditions | None = None


class Run(Protocol):
    """A run of a known number of frames, which may be walked through again and again."""

    @property
    def notes(self) -> tuple[str, ...]:
        """What was skipped or changed to make it, one line each."""
        ...

    def __len__(self) -> int: ...

    def instants(self) -> Iterator[Instant]:
        """Its frames from the first on; only one is held."""
        ...
