"""One time step of a motion: the state of the world, its neighbors in time and the commands."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

from vrcaps.world.model import State

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Float

    from vrcaps.actuation.magnet_controller import ControllerStatus
    from vrcaps.sensors.pose_filter import PoseBelief

_Item = TypeVar("_Item")


@dataclass(frozen=True)
class Command:
    """What was commanded in a simulated time step, and what the muscle did meanwhile.

    Attributes:
        force_world: Mean commanded force since the previous frame [N].
        torque_world: Mean commanded torque since the previous frame [N·m].
        insufflation: Factor on the lumen's radius at this frame, 1 = as modeled.
        T_world_patient: Pose of the patient at this frame.
        phase: Phase 1 to 4 of the migrating motor complex (MMC) at the capsule; 0 without one.
        controller: Status of the magnet controller; None without a magnet.
        estimate: Of the capsule's pose, by which the controller steers; None where it has the true.
    """

    force_world: Float[np.ndarray, " 3"]
    torque_world: Float[np.ndarray, " 3"]
    insufflation: float
    T_world_patient: Float[np.ndarray, "4 4"]
    phase: int = 0
    controller: ControllerStatus | None = None
    estimate: PoseBelief | None = None


@dataclass(frozen=True)
class Step:
    """One frame of a motion with its neighbors in time.

    All consumers of a motion take this type: the camera pipeline (motion blur, rolling shutter and
    flow need the neighbors), the sensors and the recorder.

    Example:
        >>> model, motion = vrcaps.build(vrcaps.Scenario())
        >>> for step in motion.steps():
        ...     print(step.index, step.state.time)

    Attributes:
        index: Number of the frame, counted from 0.
        state: The world at this frame; its contact is the mean since the previous frame.
        previous: The world one frame earlier; None at the first frame.
        next: The world one frame later; None at the last frame.
        command: What was commanded; None where nothing is simulated.
    """

    index: int
    state: State
    previous: State | None = None
    next: State | None = None
    command: Command | None = None


def with_neighbors(items: Iterable[_Item]) -> Iterator[tuple[_Item | None, _Item, _Item | None]]:
    """Each item between the one before and the one after; None beyond the ends."""
    previous: _Item | None = None
    current: _Item | None = None
    for following in items:
        if current is not None:
            yield previous, current, following
        previous, current = current, following
    if current is not None:
        yield previous, current, None
