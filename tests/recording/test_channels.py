from dataclasses import fields

import numpy as np
import pytest

from vrcaps.recording.channels import ENCODINGS
from vrcaps.render.frame import CHANNELS, Frame

METRIC = [name for name in CHANNELS if ENCODINGS[name].scale is not None]
RANGES = {
    "depth": (1e-5, 0.65535),
    "ray_distance": (1e-5, 0.65535),
    "foreground_depth": (1e-5, 0.65535),
    "normal": (-1.0, 1.0),
    "albedo": (0.0, 1.0),
    "arc_length": (0.0, 13.1),
    "flow_forward": (-511.9, 511.9),
    "flow_backward": (-511.9, 511.9),
}


def _shape(channel):
    components = ENCODINGS[channel].components
    return (31, 17, components) if components > 1 else (31, 17)


def test_every_channel_has_an_encoding_with_the_unit_of_frame():
    assert tuple(ENCODINGS) == CHANNELS
    units = {f.name: f.metadata["unit"] for f in fields(Frame)}
    assert {name: encoding.unit for name, encoding in ENCODINGS.items()} == units


@pytest.mark.parametrize("channel", METRIC)
def test_metric_channels_come_back_within_half_a_step(channel):
    rng, encoding = np.random.default_rng(0), ENCODINGS[channel]
    low, high = RANGES[channel]
    values = rng.uniform(low, high, _shape(channel)).astype(np.float32)
    values[3, 4] = np.nan
    values[5, 6] = low
    values[7, 8] = high
    stored = encoding.encode(values)
    assert stored.dtype == encoding.dtype
    back = encoding.decode(stored)
    assert np.isnan(back[3, 4]).all()
    assert np.count_nonzero(np.isnan(back)) == encoding.components
    valid = np.isfinite(back)
    np.testing.assert_allclose(back[valid], values[valid], rtol=1e-6, atol=0.51 * encoding.scale)
    np.testing.assert_array_equal(encoding.encode(back), stored)


@pytest.mark.parametrize("channel", ["depth", "ray_distance"])
def test_beyond_the_range_is_invalid(channel):
    """655.35 mm is the last step; 0, negative, infinite and farther values have no code."""
    values = np.array([[0.6553, 0.65536, 1.0, 0.0, -0.1, np.inf, np.nan]], np.float32)
    stored = ENCODINGS[channel].encode(values)
    np.testing.assert_array_equal(stored, [[65530, 0, 0, 0, 0, 0, 0]])
    assert ENCODINGS[channel].is_invalid(stored).sum() == 6


def test_flow_is_stored_as_kitti_does():
    """Channels (u·64 + 2¹⁵, v·64 + 2¹⁵, valid); beyond ±512 px there is no code."""
    flow = np.array([[[0.0, 1.0], [-2.5, 600.0], [np.nan, 0.0]]], np.float32)
    stored = ENCODINGS["flow_forward"].encode(flow)
    np.testing.assert_array_equal(stored, [[[32768, 32832, 1], [0, 0, 0], [0, 0, 0]]])


def test_normal_axes_are_exact():
    axes = np.concatenate([np.eye(3), -np.eye(3)])[None].astype(np.float32)
    back = ENCODINGS["normal"].decode(ENCODINGS["normal"].encode(axes))
    np.testing.assert_allclose(back, axes, atol=1e-7)


@pytest.mark.parametrize("channel", ["rgb", "label", "instance", "radiance", "position"])
def test_plain_channels_are_stored_as_they_are(channel):
    encoding, rng = ENCODINGS[channel], np.random.default_rng(1)
    values = rng.integers(0, 200, _shape(channel)).astype(encoding.dtype)
    stored = encoding.encode(values[::-1])
    assert stored.flags.c_contiguous
    np.testing.assert_array_equal(encoding.decode(stored), values[::-1])


def test_occlusion_is_black_and_white():
    mask = np.array([[True, False]])
    stored = ENCODINGS["occlusion"].encode(mask)
    np.testing.assert_array_equal(stored, [[255, 0]])
    np.testing.assert_array_equal(ENCODINGS["occlusion"].decode(stored), mask)


def test_paths():
    assert ENCODINGS["depth"].path("front", "depth", 7) == "front/depth/000007.png"
    assert ENCODINGS["position"].path("rear", "position", 123456) == "rear/position/123456.npy"
