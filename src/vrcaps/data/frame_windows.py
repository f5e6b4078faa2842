"""Map-style data set: windows of consecutive frames of many sequences."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from vrcaps.config.limits import Range, check_fields
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.transforms import invert
from vrcaps.recording.frame_sequence import CAMERA_POSE, FrameSequence

if TYPE_CHECKING:
    from numpy.typing import NDArray

FIRST_POSE = "T_first_camera"
"""Name of the camera's poses relative to the first frame of a window."""

Sample = dict[str, Any]


@dataclass(frozen=True)
class FrameWindows:
    """Windows of frames of many sequences, as a map-style data set for PyTorch's `DataLoader`.

    A sample is a dictionary of arrays: the selected channels, the values that all sequences have,
    `index` of the frame in its sequence, and `sequence`, the index in `sequences`. With a `length`
    they have a leading time axis, and `T_first_camera` is the pose of the camera at each frame
    relative to the first. Float channels hold NaN where there is no value. Images of several
    sequences must have the same size to form a batch.

    Example:
        >>> sequences = vrcaps.data.open("runs/cohort").sequences("train")
        >>> windows = vrcaps.data.FrameWindows(sequences, ("rgb", "depth"), length=3)
        >>> loader = torch.utils.data.DataLoader(windows, 8, shuffle=True, num_workers=2)

    Attributes:
        sequences: Source of the frames.
        channels: Channels to decode; None takes those that all sequences have.
        length: Frames per window; None yields single frames without a time axis.
        step: Frames from one frame of a window to the next.
        stride: Frames from the start of one window to that of the next.
        transform: Applied to each sample.
        threads: Number of threads that read images, for sequences at a URL; 0 reads sequentially.
    """

    sequences: Sequence[FrameSequence]
    channels: Sequence[str] | None = None
    length: Annotated[int | None, Range(1)] = None
    step: Annotated[int, Range(1)] = 1
    stride: Annotated[int, Range(1)] = 1
    transform: Callable[[Sample], Any] | None = None
    threads: Annotated[int, Range(0)] = 0

    def __post_init__(self) -> None:
        check_fields(self)
        if not self.sequences:
            raise InputError("There are no sequences to make windows of.")
        chosen = self.channels if self.channels is not None else _shared_channels(self.sequences)
        if not chosen:
            raise InputError("The sequences share no channel. Name channels that all of them have.")
        for sequence in self.sequences:
            for channel in chosen:
                if channel not in sequence.channels:
                    raise UnknownNameError(
                        f"channel of {sequence.name}", channel, sequence.channels
                    )
        object.__setattr__(self, "channels", tuple(chosen))
        if len(self) == 0:
            longest = max(map(len, self.sequences))
            raise InputError(
                f"A window spans {self._span} frames, the longest sequence {longest}. Give a "
                "smaller length or step."
            )

    def __len__(self) -> int:
        return int(self._ends[-1])

    def __getitem__(self, number: int) -> Any:
        """One window.

        Raises:
            IndexError: If there is no window of this index.
            InputError: If an image cannot be read.
        """
        return self.__getitems__([number])[0]

    def __getitems__(self, numbers: Sequence[int]) -> list[Any]:
        """Return several windows; a `DataLoader` requests a batch this way."""
        places = [self._place(number) for number in numbers]
        wanted = [
            (self.sequences[sequence], channel, int(frame))
            for sequence, frames in places
            for channel in self.channels or ()
            for frame in frames
        ]
        images = iter(self._read(wanted))
        samples = [self._sample(sequence, frames, images) for sequence, frames in places]
        return samples if self.transform is None else [self.transform(each) for each in samples]

    @property
    def _span(self) -> int:
        """Frames from the first to the last of a window, inclusive."""
        return ((self.length or 1) - 1) * self.step + 1

    @cached_property
    def _ends(self) -> NDArray:
        """Cumulative number of windows per sequence."""
        starts = [max(0, len(sequence) - self._span + 1) for sequence in self.sequences]
        return np.cumsum([-(-count // self.stride) for count in starts])

    @cached_property
    def _shared_values(self) -> tuple[str, ...]:
        first, *others = (sequence.values for sequence in self.sequences)
        return tuple(name for name in first if all(name in values for values in others))

    def _place(self, number: int) -> tuple[int, NDArray]:
        """Index of a window's sequence, and its frames there."""
        if not -len(self) <= number < len(self):
            raise IndexError(f"No window {number}. Allowed: 0 to {len(self) - 1}.")
        number %= len(self)
        sequence = int(np.searchsorted(self._ends, number, side="right"))
        start = (number - (self._ends[sequence - 1] if sequence else 0)) * self.stride
        return sequence, start + self.step * np.arange(self.length or 1)

    def _read(self, wanted: list[tuple[FrameSequence, str, int]]) -> list[NDArray]:
        if not self.threads:
            return [sequence.image(channel, frame) for sequence, channel, frame in wanted]
        with ThreadPoolExecutor(self.threads) as pool:
            return list(pool.map(lambda item: item[0].image(*item[1:]), wanted))

    def _sample(self, number: int, frames: NDArray, images: Any) -> Sample:
        """Arrays of a window; takes its images from an iterator."""
        sequence, sample = self.sequences[number], {}
        for channel in self.channels or ():
            sample[channel] = np.stack([next(images) for _ in frames])
        for name in self._shared_values:
            sample[name] = np.asarray(sequence.values[name][frames])
        sample["index"] = frames
        if self.length is None:
            sample = {name: array[0] for name, array in sample.items()}
        elif CAMERA_POSE in sample:
            poses = sample[CAMERA_POSE]
            sample[FIRST_POSE] = invert(poses[0]) @ poses
        return {name: np.asarray(value) for name, value in sample.items()} | {
            "sequence": np.asarray(number)
        }


def _shared_channels(sequences: Sequence[FrameSequence]) -> list[str]:
    first, *others = (sequence.channels for sequence in sequences)
    return [name for name in first if all(name in channels for channels in others)]
