"""`vrcaps.read_format`: any layout by its name."""

import numpy as np
import pytest

import vrcaps
from tests.support.ellipsoid_sequence import ellipsoid_sequence
from vrcaps.camera.lens import LensPinhole
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.formats.io import export
from vrcaps.formats.slam.tum import Tum


def test_options_reach_the_format(tmp_path):
    sequence = ellipsoid_sequence(LensPinhole(fx=25.0, fy=24.0, cx=20.25, cy=17.5), 40, 36)
    out = export(Tum(depth_scale=100000.0), [sequence], tmp_path / "out")
    (found,) = vrcaps.read_format("tum", out, depth_scale=100000.0)
    np.testing.assert_allclose(found.image("depth", 0), sequence.image("depth", 0), atol=6e-6)


def test_what_is_not_known_is_one_clear_line(tmp_path):
    with pytest.raises(UnknownNameError, match=r"No format named 'tumm'.*Did you mean 'tum'"):
        vrcaps.read_format("tumm", tmp_path)
    with pytest.raises(UnknownNameError, match=r"option of tum named 'scale'.*depth_scale"):
        vrcaps.read_format("tum", tmp_path, scale=1.0)
    with pytest.raises(InputError, match=r"folder .* does not exist"):
        vrcaps.read_format("tum", tmp_path / "absent")
    with pytest.raises(InputError, match="not a sequence in this layout"):
        vrcaps.read_format("tum", tmp_path)
