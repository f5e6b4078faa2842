"""Checks of exports that all tests of formats share."""

import numpy as np

from vrcaps.formats.io import export


def round_trip(form, sequence, folder):
    """A sequence as it is read from its export, which has its times and poses."""
    (found,) = form.read(export(form, [sequence], folder))
    assert len(found) == len(sequence)
    np.testing.assert_allclose(found.times, sequence.times, atol=1e-6)
    np.testing.assert_allclose(found.Ts_world_camera, sequence.Ts_world_camera, atol=1e-8)
    return found


def assert_same_depth(found, sequence, step, farthest=np.inf):
    """Depth is that of the sequence within half a step; what lies beyond has no value."""
    for k in range(len(sequence)):
        depth, stored = sequence.image("depth", k), found.image("depth", k)
        depth = np.where(depth <= farthest, depth, np.nan)
        assert stored.dtype == np.float32
        np.testing.assert_array_equal(np.isnan(stored), np.isnan(depth))
        np.testing.assert_allclose(stored, depth, atol=0.5 * step + 1e-7)


def assert_same_images(found, sequence, channel="rgb"):
    """Every pixel is the same."""
    for k in range(len(sequence)):
        np.testing.assert_array_equal(found.image(channel, k), sequence.image(channel, k))
