"""Interface of motions: their settings in a scenario, and the motion in a model.

A new motion is a frozen dataclass with the members of `MotionSettings`, in one file, and its name
in `vrcaps.motion.registry`. A path known in advance is a `Trajectory`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Protocol

if TYPE_CHECKING:
    import numpy as np

    from vrcaps.magnet.sources import Source
    from vrcaps.motion.step import Step
    from vrcaps.world.model import Model


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


class MotionSettings(Protocol):
    """Settings of a motion in a scenario: a frozen dataclass.

    Attributes:
        kind: Name of the motion in scenarios.
    """

    kind: ClassVar[str]

    @property
    def column_names(self) -> tuple[str, ...]:
        """Names of the columns of `Motion.columns` that all its recordings have."""
        ...

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
        ...
