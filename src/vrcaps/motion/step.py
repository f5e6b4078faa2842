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
    """Commands in a simulated time step, and the muscle's phase and controller's status.

    Attributes:
        force_world: Mean commanded force since the previous frame [N].
        torque_world: Mean commanded torque since the previous frame [N·m].
        insufflation: Factor on the lumen's radius at this frame, 1 = as modeled.
        T_world_patient: Pose of the patient at this frame.
        phase: Phase 1 to 4 of the migrating motor complex (MMC) at the capsule; 0 without one.
        controller: Status of the magnet controller; None without a magnet.
        estimate: Estimate of the capsule's pose used by the controller; None if it uses the true
            pose.
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
        index: Index of the frame, counted from 0.
        state: State of the world at this frame; its contact is the mean since the previous frame.
        previous: State one frame earlier; None at the first frame.
        next: State one frame later; None at the last frame.
        command: Commands since the previous frame; None if nothing is simulated.
    """

    index: int
    state: State
    previous: State | None = None
    next: State | None = None
    command: Command | None = None


def with_neighbors(items: Iterable[_Item]) -> Iterator[tuple[_Item | None, _Item, _Item | None]]:
    """Each item with its predecessor and successor; None beyond the ends."""
    previous: _Item | None = None
    current: _Item | None = None
    for following in items:
        if current is not None:
            yield previous, current, following
        previous, current = current, following
    if current is not None:
        yield previous, current, None
