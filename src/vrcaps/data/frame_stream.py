"""Windows of frames in a shuffled order that workers share: an iterable data set."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from vrcaps import rng
from vrcaps.data.frame_windows import FrameWindows
from vrcaps.errors import import_extra, require
from vrcaps.limits import Range, check_fields

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass
class FrameStream:
    """Every window once in each pass, as PyTorch's `DataLoader` takes an iterable data set.

    Windows are cut into shards of neighbors. Shards come in a shuffled order, and windows are drawn
    from a buffer that the shards fill: so reading stays local. The workers of a loader, and the
    ranks of a distributed training, share the shards without doubles or gaps. The order follows
    from seed, epoch and number of workers alone. A worker counts the epochs that it has begun
    itself; workers that are started anew for each epoch do not, so call `set_epoch` before each.

    Example:
        >>> windows = vrcaps.data.FrameWindows(sequences, ("rgb", "depth"))
        >>> stream = vrcaps.data.FrameStream(windows, seed=1)
        >>> loader = torch.utils.data.DataLoader(stream, 8, num_workers=2)

    Attributes:
        windows: What to give, their transform included; their `threads` read several at once.
        shuffle: Whether to shuffle; otherwise a worker gives its shards in their order.
        seed: Of the order.
        shard: Windows of a shard.
        buffer: Windows among which the next is drawn.
        rank: Number of this process in a distributed training.
        num_ranks: Processes of the training.
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
        """The next pass is the one of this number, from its beginning."""
        require(epoch >= 0, "epoch", epoch, "0 or more")
        self._next_epoch, self._epoch, self._done, self._skip = epoch, epoch, 0, 0

    def state_dict(self) -> dict[str, int]:
        """Where a pass is, to go on from: its epoch, and the windows that it gave."""
        return {"epoch": self._epoch, "done": self._done}

    def load_state_dict(self, state: dict[str, int]) -> None:
        """Let the next pass go on where `state_dict` was taken, without reading what is passed."""
        self.set_epoch(state["epoch"])
        self._skip = state["done"]

    def __iter__(self) -> Iterator[Any]:
        """A pass over the windows of this worker."""
        from torch.utils.data import get_worker_info

        info = get_worker_info()
        number, count = (0, 1) if info is None else (info.id, info.num_workers)
        self._epoch, self._done, self._skip = self._next_epoch, self._skip, 0
        self._next_epoch += 1
        order = self.order(self._epoch, self.rank * count + number, self.num_ranks * count)
        return self._pass(order[self._done :])

    def order(self, epoch: int, worker: int, num_workers: int) -> NDArray:
        """Numbers of the windows that one of several workers gives in an epoch.

        Args:
            epoch: Number of the pass.
            worker: Its number among those of all ranks.
            num_workers: How many there are.
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
    """Numbers in the order in which a buffer gives them that is kept full and drawn from."""
    waiting, found = list(numbers[:size]), []
    for number in numbers[size:]:
        place = generator.integers(len(waiting))
        found.append(waiting[place])
        waiting[place] = number
    return np.array([*found, *generator.permutation(np.array(waiting, int))], int)


@cache
def _make_iterable_style() -> None:
    """Tell PyTorch that a `FrameStream` is an iterable data set, without being a class of it."""
    import_extra("torch.utils.data", "learn", package="torch").IterableDataset.register(FrameStream)
