"""Sequences of frames: names and values of data of others are checked when they enter."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.ellipsoid_sequence import ellipsoid_sequence
from vrcaps.camera.lens import LensPinhole
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.recording.frame_sequence import CAMERA_POSE, TIME


@pytest.fixture(scope="module")
def sequence():
    return ellipsoid_sequence(LensPinhole(fx=25.0, fy=24.0, cx=20.25, cy=17.5), 40, 36, frames=3)


def _poses(sequence, change):
    poses = sequence.Ts_world_camera.copy()
    change(poses)
    return {**sequence.values, CAMERA_POSE: poses}


@pytest.mark.parametrize("name", ["../x", "/x", "a/../../x", "", None, 5])
def test_a_name_is_a_relative_path(sequence, name):
    with pytest.raises(InputError, match="The name of a sequence is"):
        replace(sequence, name=name)


def test_a_sequence_is_described_in_one_line(sequence):
    short = replace(sequence, channels=("rgb", "depth"))
    assert repr(short) == f"FrameSequence({short.name!r}, frames=3, channels=('rgb', 'depth'))"


def test_splits_and_channels_are_known(sequence):
    with pytest.raises(UnknownNameError, match=r"No split of ball/front named '\.\./x'"):
        replace(sequence, split="../x")
    with pytest.raises(UnknownNameError, match="No channel named 'smell'"):
        replace(sequence, channels=("rgb", "smell"))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_times_and_poses_are_finite(sequence, value):
    times = np.array([0.0, value, 1.0])
    with pytest.raises(InputError, match=r"time of frame 1 of ball/front is"):
        replace(sequence, values={**sequence.values, TIME: times})

    def change(poses):
        poses[2, 0, 3] = value

    with pytest.raises(
        InputError, match=r"T_world_camera of ball/front is not finite or beyond 1e9 m \(matrix 2\)"
    ):
        replace(sequence, values=_poses(sequence, change))


@pytest.mark.parametrize(
    ("place", "factor"),
    [((1, 0, 0), 1.01), ((0, 2, 1), -1.0), ((2, 3, 3), 0.0), ((1, slice(0, 3), 0), -1.0)],
)
def test_poses_are_rigid(sequence, place, factor):
    """A scale, a turned sign, a last row, and a mirror."""

    def change(poses):
        poses[place] *= factor

    with pytest.raises(InputError, match="is not a rigid transform"):
        replace(sequence, values=_poses(sequence, change))


def test_rounded_poses_are_accepted(sequence):
    values = {**sequence.values, CAMERA_POSE: sequence.Ts_world_camera.round(4)}
    assert len(replace(sequence, values=values)) == 3


def test_there_is_a_value_for_each_frame(sequence):
    with pytest.raises(InputError, match="has 2 values of T_world_camera for 3 frames"):
        replace(sequence, values={**sequence.values, CAMERA_POSE: sequence.Ts_world_camera[:2]})


@pytest.mark.parametrize(
    ("value", "message"), [(-1e-3, "negative distance"), (np.inf, "infinite value")]
)
def test_impossible_distances_are_refused(sequence, value, message):
    depth = np.full((36, 40), value, np.float32)
    broken = replace(sequence, channels=("depth",), load=lambda channel, index: depth)
    for read in (lambda: broken.image("depth", 1), lambda: broken[1]):
        with pytest.raises(
            InputError, match=f"depth of frame 1 of ball/front contains an? {message}"
        ):
            read()


@pytest.mark.parametrize(
    "error", [SyntaxError("broken chunk"), EOFError(), RecursionError("deep"), MemoryError()]
)
def test_whatever_a_library_raises_is_one_line(sequence, error):
    def load(channel, index):
        raise error

    with pytest.raises(InputError, match="Cannot read rgb of frame 0 of ball/front: ") as caught:
        replace(sequence, load=load).image("rgb", 0)
    assert caught.value.__cause__ is error
