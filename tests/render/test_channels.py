"""Declarations of channels, and the tables that follow from them."""

from __future__ import annotations

import runpy
from pathlib import Path

import numpy as np
import pytest

from tests.support.shapes import DIRECT, looking, make_camera, make_model, pinhole, sphere
from vrcaps.core.errors import InputError
from vrcaps.render.channels import CHANNELS, Frame
from vrcaps.render.renderer import Renderer

ENCODINGS = {name: channel.encoding for name, channel in CHANNELS.items()}

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


@pytest.mark.parametrize("channel", CHANNELS.values(), ids=str)
def test_every_channel_is_declared_consistently(channel):
    encoding = channel.encoding
    assert channel.meaning and channel.unit == encoding.unit
    kind = np.dtype(channel.dtype).kind
    assert encoding.is_mask == (kind == "b")
    assert (encoding.scale is None) == (kind in "bui" or encoding.suffix == ".npy")
    assert channel.shape(31, 17) == _shape(channel.name)
    assert channel.is_categorical == (kind in "bui" and channel.display != "image")
    assert bool(channel.needs) == (channel.stage == "motion")
    if channel.class_names:
        assert channel.display == "class" and channel.unit == "class"
        assert f"1 {channel.class_names[1]}" in channel.description


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


def test_the_core_fills_every_channel_of_its_stage():
    """No array keeps what it held before: the core knows each channel that is declared."""
    camera = make_camera(pinhole(16, 1.5))
    model, state = make_model(sphere(2), camera), looking((0.0, 0.0, 0.0))
    names = tuple(name for name, channel in CHANNELS.items() if channel.stage == "core")
    before = {
        name: np.full(CHANNELS[name].shape(camera.height, camera.width), 77, CHANNELS[name].dtype)
        for name in names
    }
    given = Frame(**{name: array.copy() for name, array in before.items()})
    frame = Renderer(model, DIRECT).render(state, camera, channels=iter(names), out=given)
    for name in names:
        assert getattr(frame, name) is getattr(given, name)
        assert not np.array_equal(getattr(frame, name), before[name]), name


@pytest.mark.parametrize(
    ("channel", "value"),
    [("label", 256), ("instance", 65_536), ("instance", -1), ("face", 2**24 - 1)],
)
def test_whole_numbers_beyond_the_stored_type_are_refused(channel, value):
    with pytest.raises(InputError, match=rf"{value}\. Allowed"):
        ENCODINGS[channel].encode(np.full((2, 3), value))


DOCS = Path(__file__).parents[2] / "docs"
SCRIPT = runpy.run_path(str(DOCS / "channel_tables.py"))


@pytest.mark.parametrize("page", SCRIPT["TABLES"])
def test_tables_are_up_to_date(page):
    text = (DOCS / page).read_text("utf-8")
    table = SCRIPT["TABLES"][page]()
    assert SCRIPT["with_table"](text, table) == text, "Run: python docs/channel_tables.py"
