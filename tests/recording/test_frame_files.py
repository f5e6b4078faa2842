"""Images of an episode: PNG and NumPy files."""

from __future__ import annotations

import struct
import zlib

import numpy as np
import pytest

from vrcaps.recording.frame_files import read_image, write_images


@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
@pytest.mark.parametrize("shape", [(5, 7), (5, 7, 3)])
def test_png_round_trip(tmp_path, dtype, shape):
    """Our own reader and OpenCV (which has BGR) agree with what was written."""
    import cv2

    values = np.random.default_rng(0).integers(0, np.iinfo(dtype).max, shape).astype(dtype)
    write_images([(tmp_path / "image.png", values)])
    np.testing.assert_array_equal(read_image(tmp_path / "image.png"), values)
    other = cv2.imread(str(tmp_path / "image.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(other[..., ::-1] if len(shape) == 3 else other, values)


def test_npy_round_trip(tmp_path):
    values = np.array([[1.0, np.nan]], np.float32)
    write_images([(tmp_path / "values.npy", values)])
    np.testing.assert_array_equal(read_image(tmp_path / "values.npy"), values)


def test_read_errors_are_os_or_value_errors(tmp_path):
    for name in ("cut.png", "cut.npy"):
        (tmp_path / name).write_bytes(b"\x89PNG or not")
        with pytest.raises((OSError, ValueError)):
            read_image(tmp_path / name)
    with pytest.raises(OSError, match="missing"):
        read_image(tmp_path / "missing.png")


def test_each_write_has_a_temporary_name_of_its_own(tmp_path):
    """Two writers of one image do not share a file; what is in the way stays."""
    (tmp_path / ".image.png.tmp").mkdir()
    write_images([(tmp_path / "image.png", np.zeros((2, 2), np.uint8))])
    assert sorted(path.name for path in tmp_path.iterdir()) == [".image.png.tmp", "image.png"]


def test_a_png_that_says_more_than_its_bytes_can_hold_is_refused(tmp_path):
    """Before memory is taken: 200 bytes that say 65,000 by 65,000 pixels."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    head = struct.pack(">IIBBBBB", 65_000, 65_000, 16, 2, 0, 0, 0)
    data = zlib.compress(bytes(1000))
    path = tmp_path / "bomb.png"
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", data) + chunk(b"IEND", b"")
    )
    with pytest.raises(ValueError, match=r"declares 65000 x 65000 pixels\. Allowed: 1 to 67108864"):
        read_image(path)


def test_an_even_image_is_read_however_well_it_packs(tmp_path):
    write_images([(tmp_path / "even.png", np.zeros((2000, 3000), np.uint8))])
    assert not read_image(tmp_path / "even.png").any()
