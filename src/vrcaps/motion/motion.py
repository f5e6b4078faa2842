"""Interface of motions: time steps, the motion in a model, and its settings in a scenario.

A new motion is a frozen dataclass that extends `MotionSettings`, registered in `MOTIONS`. A path
known in advance is a `Trajectory`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Protocol, TypeVar

from vrcaps.config.convert import register_family
from vrcaps.core.registry import Registry
from vrcaps.world.model import State

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Float

    from vrcaps.actuation.coil_program import CoilStatus
    from vrcaps.actuation.magnet_controller import ControllerStatus
    from vrcaps.magnet.sources import Source
    from vrcaps.sensors.pose_filter import PoseBelief
    from vrcaps.world.model import Model

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
        coils: State of the coils; None without coils.
    """

    force_world: Float[np.ndarray, " 3"]
    torque_world: Float[np.ndarray, " 3"]
    insufflation: float
    T_world_patient: Float[np.ndarray, "4 4"]
    phase: int = 0
    controller: ControllerStatus | None = None
    estimate: PoseBelief | None = None
    coils: CoilStatus | None = None


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


@dataclass(frozen=True)
class MotionState:
    """State from which a motion resumes after a frame, to the same bytes.

    Attributes:
        frame: Index of the frame.
        arrays: State of the motion, by name.
    """

    frame: int
    arrays: Mapping[str, np.ndarray]


class Motion(Protocol):
    """Motion of the capsule in a model, with a known number of frames.

    It can be iterated repeatedly; each iteration gives the same bytes.
    """

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on skipped or changed input, one line each."""
        ...

    def __len__(self) -> int: ...

    def steps(
        self,
        resume: MotionState | None = None,
        *,
        progress: Callable[[float, float], None] | None = None,
        is_due: Callable[[], bool] | None = None,
    ) -> Iterator[Step]:
        """Iterate over the frames with their neighbors in time.

        Args:
            resume: Result of `checkpoint`: start with the frame after it; None starts with frame 0.
            progress: Called with the time simulated so far and the total time [s].
            is_due: Called at each frame; returns whether `checkpoint` should store it.
        """
        ...

    def checkpoint(self) -> MotionState | None:
        """Return the state at the last step yielded; None if none was due or none is needed."""
        ...

    def columns(self, step: Step) -> Mapping[str, float | str]:
        """Columns of `frames.parquet` specific to this motion, for a step."""
        ...

    def sources(self, step: Step) -> Sequence[Source]:
        """Magnetic field sources outside the capsule at a step."""
        ...


class MotionSettings:
    """Base class of the settings of a motion in a scenario; subclasses are frozen dataclasses.

    Attributes:
        kind: Name of the motion in scenarios.
    """

    kind: ClassVar[str]

    @property
    def column_names(self) -> tuple[str, ...]:
        """Names of the columns of `Motion.columns` in all recordings; none by default."""
        return ()

    def begin(
        self, model: Model, *, frames: int, fps: float, seed: int, shown: Model | None = None
    ) -> Motion:
        """Create the motion in a model.

        Args:
            model: The lumen and the capsule.
            frames: Number of frames, at least 1.
            fps: Frames per second.
            seed: Seed of all random numbers.
            shown: Model whose wall the states contain, with the same triangles, such as the clean
                twin; None for `model`.

        Raises:
            InputError: If the motion is not possible in the model.
        """
        raise NotImplementedError


MOTIONS: Registry[MotionSettings] = Registry(
    "motion",
    {
        "fly-through": ("vrcaps.motion.fly_through:FlyThrough", "along the centerline"),
        "random-views": ("vrcaps.motion.random_views:RandomViews", "random views of the wall"),
        "replay": ("vrcaps.motion.replay:Replay", "along a recorded path"),
        "dynamics": ("vrcaps.motion.dynamics:Dynamics", "by gravity, contact, muscle and magnets"),
    },
)
"""Motions by name, including those of plug-ins."""

register_family(MotionSettings, MOTIONS)
