"""EndoMapper's simulated sequences: round trip, and the rules of both of its readers."""

import sys

import numpy as np
import OpenEXR
import pytest

from tests.support.ellipsoid_sequence import ellipsoid_sequence
from tests.support.exported import assert_same_depth, assert_same_images, round_trip
from vrcaps.camera.lens import LensPinhole
from vrcaps.core.errors import InputError, MissingExtraError
from vrcaps.formats.endoscopy.endomapper import EndoMapper, read_exr
from vrcaps.formats.io import export

LENS = LensPinhole(fx=25.0, fy=24.0, cx=20.25, cy=17.5)


@pytest.fixture
def sequence():
    return ellipsoid_sequence(LENS, 40, 36, frames=3)


@pytest.mark.parametrize("depth", ["z-buffer", "linear"])
def test_what_was_written_is_read(sequence, tmp_path, depth):
    found = round_trip(EndoMapper(depth=depth), sequence, tmp_path / "out")
    assert found.camera.lens == LENS
    assert (found.camera.width, found.camera.height) == (40, 36)
    assert_same_images(found, sequence)
    assert_same_depth(found, sequence, 1e-7)


def test_depth_is_as_its_readers_take_it(sequence, tmp_path):
    """1 / (x (1 − v) + y) / … with near 0.01, far 4 gives decimeters; or decimeters as they are."""
    for kind in ("z-buffer", "linear"):
        out = export(EndoMapper(depth=kind), [sequence], tmp_path / kind)
        with OpenEXR.File(str(next(out.rglob("aov_image_0001.exr")))) as file:
            v = file.channels()["RGB"].pixels[..., 0].astype(float)
        if kind == "z-buffer":
            near, far = 0.01, 4.0
            x, y = 1.0 - far / near, far / near
            v = 1.0 / (x / far * (1.0 - v) + y / far)
        np.testing.assert_allclose(v / 10, sequence.image("depth", 1), rtol=2e-6)


def test_damaged_rows_take_their_frames(sequence, tmp_path):
    out = export(EndoMapper(), [sequence], tmp_path / "out")
    path = next(out.rglob("trajectory.csv"))
    lines = path.read_text().splitlines()
    lines[2] = "1;2;3;NaN;0;0;1;0.1"
    path.write_text("\n".join(lines))
    (found,) = EndoMapper().read(out)
    np.testing.assert_allclose(found.times, sequence.times[[0, 2]])
    np.testing.assert_array_equal(found.image("rgb", 1), sequence.image("rgb", 2))


def test_damage_is_one_clear_line(sequence, tmp_path):
    out = export(EndoMapper(), [sequence], tmp_path / "out")
    (found,) = EndoMapper().read(out)
    next(out.rglob("aov_image_0001.exr")).write_bytes(b"junk")
    with pytest.raises(InputError, match=r"Cannot read .*aov_image_0001"):
        found.image("depth", 1)
    path = tmp_path / "blue.exr"
    header = {"type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, {"B": np.zeros((2, 3), np.float32)}) as file:
        file.write(str(path))
    with pytest.raises(InputError, match="has no complete red channel"):
        read_exr(path)
    next(out.rglob("calibration.txt")).write_text("fx: 3\nfy: 4\n")
    with pytest.raises(InputError, match=r"It must contain `key: number` for fx"):
        EndoMapper().read(out)


def test_missing_package_is_named(sequence, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "OpenEXR", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'vrcaps\[formats\]'"):
        export(EndoMapper(), [sequence], tmp_path / "out")
    assert not list(tmp_path.iterdir())
