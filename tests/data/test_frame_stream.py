"""A stream of windows: every one once, whoever shares them, in an order that the seed decides."""

import itertools
import pickle
import sys
from functools import partial

import numpy as np
import pytest
from torch.utils.data import DataLoader, IterableDataset

from tests.support.waiting import WATCHDOG
from vrcaps.core.errors import InputError, MissingExtraError
from vrcaps.data import frame_stream
from vrcaps.data.frame_stream import FrameStream
from vrcaps.data.frame_windows import FrameWindows
from vrcaps.recording.frame_sequence import FrameSequence


def load(base: int, channel: str, index: int) -> np.ndarray:
    return np.full((2, 2), base + index, np.uint16)


@pytest.fixture
def windows() -> FrameWindows:
    """A hundred frames of three sequences; each image tells its number."""
    spans = itertools.pairwise([0, 30, 35, 100])
    return FrameWindows(
        [
            FrameSequence(f"{a}", ("instance",), {"time": np.arange(b - a) / 4.0}, partial(load, a))
            for a, b in spans
        ]
    )


def numbers(stream) -> list[int]:
    return [int(sample["instance"].flat[0]) for sample in stream]


@pytest.mark.parametrize("shuffle", [False, True])
@pytest.mark.parametrize("shares", [1, 2, 3, 30])
def test_shares_have_every_window_once(windows, shuffle, shares):
    stream = FrameStream(windows, shuffle, shard=8, buffer=10)
    for epoch in (0, 1):
        found = [stream.order(epoch, k, shares) for k in range(shares)]
        assert sorted(np.concatenate(found)) == list(range(100))
        assert max(map(len, found)) - min(map(len, found)) <= 8


def test_the_order_is_that_of_seed_and_epoch(windows):
    stream = FrameStream(windows, seed=1, shard=8, buffer=20)
    first, second = numbers(stream), numbers(stream)
    assert sorted(first) == sorted(second) == list(range(100))
    assert first != second
    assert numbers(FrameStream(windows, seed=1, shard=8, buffer=20)) == first
    assert numbers(FrameStream(windows, seed=2, shard=8, buffer=20)) != first
    stream.set_epoch(1)
    assert numbers(stream) == second
    assert numbers(FrameStream(windows, shuffle=False)) == list(range(100))


def test_shuffling_goes_beyond_a_shard_but_not_beyond_the_buffer(windows):
    order = FrameStream(windows, shard=10, buffer=30).order(0, 0, 1)
    assert len({k // 10 for k in order[:10]}) > 2
    assert len({k // 10 for k in order[:10]}) <= 4  # 30 in the buffer and 10 that came since


def test_a_pass_goes_on_where_it_was(windows):
    stream = FrameStream(windows, seed=3)
    stream.set_epoch(4)
    whole = numbers(stream)
    stream.set_epoch(4)
    begun = numbers(itertools.islice(stream, 37))
    fresh = FrameStream(windows, seed=3)
    fresh.load_state_dict(stream.state_dict())
    assert begun + numbers(fresh) == whole
    assert numbers(fresh) != whole  # the epoch after it


def test_threads_give_the_same_order(windows):
    threaded = FrameWindows(windows.sequences, threads=3)
    assert numbers(FrameStream(threaded)) == numbers(FrameStream(windows))


def test_workers_of_a_loader_share_it_in_each_epoch(windows):
    stream = FrameStream(windows, shard=8)
    assert isinstance(stream, IterableDataset)
    loader = DataLoader(
        *(stream, 7),
        num_workers=2,
        multiprocessing_context="fork",
        persistent_workers=True,
        timeout=WATCHDOG,
    )
    passes = [numbers(loader_samples(loader)) for _ in range(2)]
    assert sorted(passes[0]) == sorted(passes[1]) == list(range(100))
    assert passes[0] != passes[1]


def test_it_goes_to_other_processes_as_bytes(windows):
    stream = FrameStream(windows, seed=5)
    stream.set_epoch(2)
    assert numbers(pickle.loads(pickle.dumps(stream))) == numbers(stream)


def loader_samples(loader):
    """Samples of all batches."""
    for batch in loader:
        yield from ({"instance": image.numpy()} for image in batch["instance"])


def test_ranks_of_a_training_share_it(windows):
    found = [numbers(FrameStream(windows, rank=k, num_ranks=3, shard=5)) for k in range(3)]
    assert sorted(itertools.chain(*found)) == list(range(100))


def test_without_pytorch_the_extra_is_named(windows, monkeypatch):
    frame_stream._make_iterable_style.cache_clear()
    monkeypatch.setitem(sys.modules, "torch.utils.data", None)
    with pytest.raises(MissingExtraError, match=r"torch is not installed.*vrcaps\[learn\]"):
        FrameStream(windows)


def test_bad_settings_are_one_clear_line(windows):
    with pytest.raises(InputError, match=r"rank is 2\. Allowed: 0 to 1"):
        FrameStream(windows, rank=2, num_ranks=2)
    with pytest.raises(InputError, match="buffer is 0"):
        FrameStream(windows, buffer=0)
    with pytest.raises(InputError, match="epoch is -1"):
        FrameStream(windows).set_epoch(-1)
