"""Windows of frames and their stream: contents, batches of a loader, order and resuming."""

import itertools
import pickle
import sys
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader, IterableDataset

from tests.support.waiting import WATCHDOG
from vrcaps.core.errors import InputError, MissingExtraError, UnknownNameError
from vrcaps.core.geometry import rotation_from_vector, transform_from
from vrcaps.data import loading
from vrcaps.data.loading import FrameStream, FrameWindows
from vrcaps.recording.frame_sequence import FrameSequence


def load(base: int, channel: str, index: int) -> np.ndarray:
    """An image that tells sequence, channel and frame; its depth has a pixel without a value."""
    if channel == "rgb":
        return np.full((4, 5, 3), base + index, np.uint8)
    depth = np.full((4, 5), 1e-3 * (base + index), np.float32)
    depth[0, 0] = np.nan
    return depth


def made_sequence(length: int, base: int, channels=("rgb", "depth")) -> FrameSequence:
    vectors = 0.1 * np.arange(length)[:, None] * [1.0, 2.0, 3.0] + base
    poses = transform_from(rotation_from_vector(vectors), 1e-3 * vectors)
    values = {"time": np.arange(length) / 4.0, "T_world_camera": poses}
    return FrameSequence(f"made-{base}", channels, values, partial(load, base))


@pytest.fixture
def sequences():
    return [made_sequence(7, 0), made_sequence(2, 50), made_sequence(5, 100)]


@pytest.mark.parametrize(
    ("length", "step", "stride"), [(None, 1, 1), (1, 1, 2), (3, 1, 1), (2, 2, 3)]
)
def test_windows_are_all_that_fit_into_a_sequence(sequences, length, step, stride):
    windows = FrameWindows(sequences, length=length, step=step, stride=stride)
    frames = np.arange(length or 1) * step
    expected = [
        (number, (start + frames).tolist())
        for number, sequence in enumerate(sequences)
        for start in range(0, len(sequence), stride)
        if start + frames[-1] < len(sequence)
    ]
    found = [(int(w["sequence"]), np.atleast_1d(w["index"]).tolist()) for w in windows]
    assert found == expected
    assert len(windows) == len(expected)
    assert windows[-1]["sequence"] == expected[-1][0]
    with pytest.raises(IndexError, match=f"No window {len(expected)}"):
        windows[len(expected)]


def test_a_window_holds_the_arrays_of_its_frames(sequences):
    sample = FrameWindows(sequences, ["depth"], length=3)[6]
    assert sample.keys() == {
        *("depth", "time", "T_world_camera", "T_first_camera", "index", "sequence")
    }
    third = sequences[2]
    np.testing.assert_array_equal(sample["depth"], [third.load("depth", k) for k in (1, 2, 3)])
    poses = third.Ts_world_camera[1:4]
    np.testing.assert_allclose(poses[0] @ sample["T_first_camera"], poses, atol=1e-15)
    np.testing.assert_allclose(sample["T_first_camera"][0], np.eye(4), atol=1e-15)


def test_only_what_all_sequences_have_is_in_a_sample(sequences):
    without = replace(sequences[1], channels=("rgb",), values={"time": np.arange(2.0)})
    sample = FrameWindows([*sequences, without])[0]
    assert sample.keys() == {"rgb", "time", "index", "sequence"}
    assert sample["rgb"].shape == (4, 5, 3)


def test_threads_read_the_same(sequences):
    plain = FrameWindows(sequences, length=2)
    threaded = replace(plain, threads=3)
    for ours, theirs in zip(plain, threaded, strict=True):
        for name, array in ours.items():
            np.testing.assert_array_equal(theirs[name], array)


def test_a_loader_with_workers_gives_every_window_once(sequences):
    made = FrameWindows(sequences, length=2, transform=partial(replace_depth, 7.0))
    windows = pickle.loads(pickle.dumps(made))  # as workers that are not forked take it
    loader = DataLoader(windows, 3, num_workers=2, multiprocessing_context="fork", timeout=WATCHDOG)
    batches = list(loader)
    assert batches[0]["rgb"].shape == (3, 2, 4, 5, 3)
    assert batches[0]["rgb"].dtype == torch.uint8
    assert all(torch.all(batch["depth"] == 7.0) for batch in batches)
    found = torch.cat([batch["rgb"][:, 0, 0, 0, 0] for batch in batches])
    assert found.tolist() == [*range(6), 50, *range(100, 104)]


def replace_depth(value, sample):
    return sample | {"depth": np.full_like(sample["depth"], value)}


def test_no_value_stays_no_value_in_a_batch(sequences):
    batch = next(iter(DataLoader(FrameWindows(sequences), batch_size=4)))
    assert torch.isnan(batch["depth"]).sum(dim=(1, 2)).tolist() == [1, 1, 1, 1]


def test_bad_windows_are_one_clear_line(sequences):
    with pytest.raises(InputError, match="no sequences"):
        FrameWindows([])
    with pytest.raises(UnknownNameError, match=r"No channel of made-0 named 'dept'.*'depth'"):
        FrameWindows(sequences, ["dept"])
    with pytest.raises(InputError, match="spans 9 frames, the longest sequence 7"):
        FrameWindows(sequences, length=5, step=2)
    with pytest.raises(InputError, match=r"length is 0\. Allowed: 1 or more"):
        FrameWindows(sequences, length=0)
    with pytest.raises(InputError, match="share no channel"):
        FrameWindows([made_sequence(2, 0, ("rgb",)), made_sequence(2, 0, ("depth",))])


def indexed_image(base: int, channel: str, index: int) -> np.ndarray:
    return np.full((2, 2), base + index, np.uint16)


@pytest.fixture
def windows() -> FrameWindows:
    """A hundred frames of three sequences; each image tells its number."""
    spans = itertools.pairwise([0, 30, 35, 100])
    return FrameWindows(
        [
            FrameSequence(
                f"{a}", ("instance",), {"time": np.arange(b - a) / 4.0}, partial(indexed_image, a)
            )
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
    loading._make_iterable_style.cache_clear()
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
