"""Windows of frames: which frames they hold, and what a loader makes of them."""

import pickle
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

from tests.support.waiting import WATCHDOG
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.transforms import rotation_from_vector, transform_from
from vrcaps.data.frame_windows import FrameWindows
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
