"""Data sets for PyTorch: windows of frames, map-style or as a shuffled stream."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from vrcaps.core import rng
from vrcaps.core.errors import InputError, UnknownNameError, import_extra, require
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.geometry import invert
from vrcaps.core.processes import MAX_WORKERS
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
    threads: Annotated[int, Range(0, MAX_WORKERS)] = 0

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

    def __getitem__(self, index: int) -> Any:
        """One window.

        Raises:
            IndexError: If there is no window of this index.
            InputError: If an image cannot be read.
        """
        return self.__getitems__([index])[0]

    def __getitems__(self, indices: Sequence[int]) -> list[Any]:
        """Return several windows; a `DataLoader` requests a batch this way."""
        positions = [self._place(index) for index in indices]
        wanted = [
            (self.sequences[sequence], channel, int(frame))
            for sequence, frames in positions
            for channel in self.channels or ()
            for frame in frames
        ]
        images = iter(self._read(wanted))
        samples = [self._sample(sequence, frames, images) for sequence, frames in positions]
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

    def _place(self, index: int) -> tuple[int, NDArray]:
        """Index of a window's sequence, and its frames there."""
        if not -len(self) <= index < len(self):
            raise IndexError(f"No window {index}. Allowed: 0 to {len(self) - 1}.")
        index %= len(self)
        sequence = int(np.searchsorted(self._ends, index, side="right"))
        start = (index - (self._ends[sequence - 1] if sequence else 0)) * self.stride
        return sequence, start + self.step * np.arange(self.length or 1)

    def _read(self, wanted: list[tuple[FrameSequence, str, int]]) -> list[NDArray]:
        if not self.threads:
            return [sequence.image(channel, frame) for sequence, channel, frame in wanted]
        with ThreadPoolExecutor(self.threads) as pool:
            return list(pool.map(lambda item: item[0].image(*item[1:]), wanted))

    def _sample(self, index: int, frames: NDArray, images: Any) -> Sample:
        """Arrays of a window; takes its images from an iterator."""
        sequence, sample = self.sequences[index], {}
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
            "sequence": np.asarray(index)
        }


def _shared_channels(sequences: Sequence[FrameSequence]) -> list[str]:
    first, *others = (sequence.channels for sequence in sequences)
    return [name for name in first if all(name in channels for channels in others)]


@dataclass
class FrameStream:
    """Iterable data set for PyTorch's `DataLoader` with every window once per epoch.

    Windows are cut into shards of neighbors. Shards come in a shuffled order, and windows are drawn
    from a shuffle buffer that the shards fill, so reads stay local. The workers of a loader and the
    ranks of a distributed training partition the shards without duplicates or gaps. The order
    depends only on seed, epoch and number of workers. A worker counts its epochs itself, but not if
    it is restarted for each epoch; then call `set_epoch` before each.

    Example:
        >>> windows = vrcaps.data.FrameWindows(sequences, ("rgb", "depth"))
        >>> stream = vrcaps.data.FrameStream(windows, seed=1)
        >>> loader = torch.utils.data.DataLoader(stream, 8, num_workers=2)

    Attributes:
        windows: Windows to yield, including their transform; their `threads` read several at once.
        shuffle: Whether to shuffle; otherwise a worker yields its shards in order.
        seed: Random seed of the order.
        shard: Number of windows in a shard.
        buffer: Number of windows in the shuffle buffer.
        rank: Rank of this process in a distributed training.
        num_ranks: Number of processes of the training.
    """

    windows: FrameWindows
    shuffle: bool = True
    seed: Annotated[int, Range(0, rng.MAX_SEED)] = 0
    shard: Annotated[int, Range(1)] = 64
    buffer: Annotated[int, Range(1)] = 1024
    rank: Annotated[int, Range(0)] = 0
    num_ranks: Annotated[int, Range(1)] = 1

    def __post_init__(self) -> None:
        check_fields(self)
        require(self.rank < self.num_ranks, "rank", self.rank, f"0 to {self.num_ranks - 1}")
        _make_iterable_style()
        self.set_epoch(0)

    def set_epoch(self, epoch: int) -> None:
        """Set the epoch of the next pass, which starts from its beginning."""
        require(epoch >= 0, "epoch", epoch, "0 or more")
        self._next_epoch, self._epoch, self._done, self._skip = epoch, epoch, 0, 0

    def state_dict(self) -> dict[str, int]:
        """State of a pass for resuming: its epoch and the number of windows yielded."""
        return {"epoch": self._epoch, "done": self._done}

    def load_state_dict(self, state: dict[str, int]) -> None:
        """Resume the next pass at the position of `state_dict`, without reading earlier windows."""
        self.set_epoch(state["epoch"])
        self._skip = state["done"]

    def __iter__(self) -> Iterator[Any]:
        """Iterate over the windows of this worker."""
        from torch.utils.data import get_worker_info

        info = get_worker_info()
        index, count = (0, 1) if info is None else (info.id, info.num_workers)
        self._epoch, self._done, self._skip = self._next_epoch, self._skip, 0
        self._next_epoch += 1
        order = self.order(self._epoch, self.rank * count + index, self.num_ranks * count)
        return self._pass(order[self._done :])

    def order(self, epoch: int, worker: int, num_workers: int) -> NDArray:
        """Indices of the windows that one of several workers yields in an epoch.

        Args:
            epoch: Index of the epoch.
            worker: Index of the worker among those of all ranks.
            num_workers: Number of workers of all ranks.
        """
        shards = np.arange(0, len(self.windows), self.shard)
        if self.shuffle:
            shards = rng.stream(self.seed, "data/stream/shards", epoch).permutation(shards)
        size = len(self.windows)
        own = [np.arange(k, min(k + self.shard, size)) for k in shards[worker::num_workers]]
        indices = np.concatenate([np.arange(0), *own])
        if not self.shuffle:
            return indices
        generator = rng.stream(self.seed, "data/stream/buffer", epoch, worker, num_workers)
        return _drawn_from_buffer(indices, self.buffer, generator)

    def _pass(self, order: NDArray) -> Iterator[Any]:
        threads = self.windows.threads
        windows = replace(self.windows, threads=0)
        if not threads:
            for index in order:
                self._done += 1
                yield windows[index]
            return
        waiting: deque[Future[Any]] = deque()
        with ThreadPoolExecutor(threads) as pool:
            for index in order:
                waiting.append(pool.submit(windows.__getitem__, index))
                if len(waiting) > 2 * threads:
                    self._done += 1
                    yield waiting.popleft().result()
            for future in waiting:
                self._done += 1
                yield future.result()


def _drawn_from_buffer(indices: NDArray, size: int, generator: np.random.Generator) -> NDArray:
    """Indices in the order in which a full buffer yields them."""
    waiting, order = list(indices[:size]), []
    for index in indices[size:]:
        position = generator.integers(len(waiting))
        order.append(waiting[position])
        waiting[position] = index
    return np.array([*order, *generator.permutation(np.array(waiting, int))], int)


@cache
def _make_iterable_style() -> None:
    """Register `FrameStream` with PyTorch as an iterable data set, without inheritance."""
    import_extra("torch.utils.data", "learn", package="torch").IterableDataset.register(FrameStream)
