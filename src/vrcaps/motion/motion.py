"""Interface of motions: what a scenario asks for, and what runs in a model.

A new motion is a frozen dataclass with the members of `MotionSettings`, in one file, and its name
in `vrcaps.motion.registry`. A path that is known beforehand starts as a `Trajectory`.
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
    """All that a motion needs to go on from a frame to the same bytes.

    Attributes:
        frame: Number of the frame.
        arrays: What the motion keeps, by name.
    """

    frame: int
    arrays: Mapping[str, np.ndarray]


class Motion(Protocol):
    """A motion of the capsule in a model, of a known number of frames.

    It can be walked through again and again; each walk gives the same bytes.
    """

    @property
    def notes(self) -> tuple[str, ...]:
        """What was skipped or changed to make it, one line each."""
        ...

    def __len__(self) -> int: ...

    def steps(
        self,
        resume: MotionState | None = None,
        *,
        progress: Callable[[float, float], None] | None = None,
        is_due: Callable[[], bool] | None = None,
    ) -> Iterator[Step]:
        """Its frames with their neighbors in time.

        Args:
            resume: Of `checkpoint`: begin with the frame after; None begins with frame 0.
            progress: Called with the time simulated so far and in all [s].
            is_due: Asked at each frame whether `checkpoint` is to know it.
        """
        ...

    def checkpoint(self) -> MotionState | None:
        """The state at the step given last; None where none was due or none is needed."""
        ...

    def columns(self, step: Step) -> Mapping[str, float | str]:
        """Columns of `frames.parquet` that only this motion has, for a step."""
        ...

    def sources(self, step: Step) -> Sequence[Source]:
        """Sources of magnetic fields outside the capsule at a step."""
        ...


class MotionSettings(Protocol):
    """What a scenario says of a motion: a frozen dataclass.

    Attributes:
        kind: Its name in scenarios.
    """

    kind: ClassVar[str]

    @property
    def column_names(self) -> tuple[str, ...]:
        """Names of the columns of `Motion.columns` that every recording of it has."""
        ...

    def begin(
        self, model: Model, *, frames: int, fps: float, seed: int, shown: Model | None = None
    ) -> Motion:
        """The motion in a model.

        Args:
            model: The lumen and the capsule.
            frames: Number of frames, at least 1.
            fps: Frames per second.
            seed: Of all that is random in it.
            shown: The model whose wall the states hold, one with the same triangles, such as the
                clean twin; None is `model`.

        Raises:
            InputError: If the capsule cannot move so in the model.
        """
        ...
