"""Iterable data set: windows of frames in a shuffled order shared by workers."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from vrcaps.config.limits import Range, check_fields
from vrcaps.core import rng
from vrcaps.core.errors import import_extra, require
from vrcaps.data.frame_windows import FrameWindows

if TYPE_CHECKING:
    from numpy.typing import NDArray


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
    seed: Annotated[int, Range(0)] = 0
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
        number, count = (0, 1) if info is None else (info.id, info.num_workers)
        self._epoch, self._done, self._skip = self._next_epoch, self._skip, 0
        self._next_epoch += 1
        order = self.order(self._epoch, self.rank * count + number, self.num_ranks * count)
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
        numbers = np.concatenate([np.arange(0), *own])
        if not self.shuffle:
            return numbers
        generator = rng.stream(self.seed, "data/stream/buffer", epoch, worker, num_workers)
        return _drawn_from_buffer(numbers, self.buffer, generator)

    def _pass(self, order: NDArray) -> Iterator[Any]:
        threads = self.windows.threads
        windows = replace(self.windows, threads=0)
        if not threads:
            for number in order:
                self._done += 1
                yield windows[number]
            return
        waiting: deque[Future[Any]] = deque()
        with ThreadPoolExecutor(threads) as pool:
            for number in order:
                waiting.append(pool.submit(windows.__getitem__, number))
                if len(waiting) > 2 * threads:
                    self._done += 1
                    yield waiting.popleft().result()
            for future in waiting:
                self._done += 1
                yield future.result()


def _drawn_from_buffer(numbers: NDArray, size: int, generator: np.random.Generator) -> NDArray:
    """Indices in the order in which a full buffer yields them."""
    waiting, found = list(numbers[:size]), []
    for number in numbers[size:]:
        place = generator.integers(len(waiting))
        found.append(waiting[place])
        waiting[place] = number
    return np.array([*found, *generator.permutation(np.array(waiting, int))], int)


@cache
def _make_iterable_style() -> None:
    """Register `FrameStream` with PyTorch as an iterable data set, without inheritance."""
    import_extra("torch.utils.data", "learn", package="torch").IterableDataset.register(FrameStream)
