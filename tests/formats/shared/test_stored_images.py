"""One decoder for all images: sizes are bounded, orientation and inks are the same everywhere."""

import io
import struct
import subprocess
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image, ImageOps

from vrcaps.core.errors import InputError
from vrcaps.formats.shared.stored_images import decoded_rgb, image_size, read_plane, read_rgb
from vrcaps.tools.photometric_calibration.frames import jpeg_quality
from vrcaps.tools.photos import read_photos


def _picture() -> Image.Image:
    """Six blocks of different gray: no turn of it looks like another."""
    blocks = np.arange(6, dtype=np.uint8).reshape(2, 3) * 40
    return Image.fromarray(np.kron(blocks, np.ones((16, 16), np.uint8))).convert("RGB")


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".tif", ".webp"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_exif_orientation_is_applied_by_every_reader(tmp_path, orientation, suffix):
    path, exif = tmp_path / f"a{suffix}", Image.Exif()
    exif[274] = orientation
    options = {"tiffinfo": {274: orientation}} if suffix == ".tif" else {"exif": exif}
    _picture().save(path, **options)
    with Image.open(path) as image:
        expected = np.asarray(ImageOps.exif_transpose(image).convert("RGB"))
    np.testing.assert_array_equal(read_rgb(path), expected)
    np.testing.assert_array_equal(read_photos([path])[0].rgb, expected)
    assert image_size(path) == expected.shape[:2]
    if suffix != ".tif":
        np.testing.assert_array_equal(decoded_rgb(path.read_bytes()), expected)


@pytest.mark.parametrize("suffix", [".jpg", ".tif"])
def test_inks_become_colors(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    Image.new("RGB", (20, 10), (90, 90, 90)).convert("CMYK").save(path)
    assert np.abs(read_rgb(path).astype(int) - 90).max() <= 1
    assert np.abs(read_photos([path])[0].rgb.astype(int) - 90).max() <= 1


@pytest.mark.parametrize("mode", ["1", "L", "P", "LA", "RGBA", "I;16"])
def test_every_kind_of_png_becomes_color(tmp_path, mode):
    path = tmp_path / "a.png"
    if mode == "I;16":
        Image.fromarray(np.full((4, 5), 255 << 8, np.uint16)).save(path)
    else:
        Image.new("RGB", (5, 4), (255, 255, 255)).convert(mode).save(path)
    found = read_rgb(path)
    assert found.shape == (4, 5, 3)
    assert (found == 255).all()


def test_palettes_of_tiff_become_color_and_stay_numbers(tmp_path):
    path = tmp_path / "a.tif"
    image = Image.new("P", (5, 4), 1)
    image.putpalette([0, 0, 0, 10, 20, 30] + [0] * 762)
    image.save(path)
    assert (read_rgb(path) == (10, 20, 30)).all()
    assert (read_plane(path) == 1).all()


def _png(width: int, height: int) -> bytes:
    def chunk(kind: bytes, data: bytes) -> bytes:
        check = struct.pack(">I", zlib.crc32(kind + data))
        return struct.pack(">I", len(data)) + kind + data + check

    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    body = chunk(b"IDAT", zlib.compress(bytes(100))) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + body


def _tiff() -> bytes:
    data = io.BytesIO()
    tifffile.imwrite(data, np.zeros((4, 5), np.uint8))
    stored = bytearray(data.getvalue())
    for tag in (256, 257):  # width and height, in an entry of 12 bytes: tag, type, count, value
        at = stored.index(struct.pack("<HH", tag, 4))
        stored[at + 8 : at + 12] = struct.pack("<I", 60_000)
    return bytes(stored)


def _npy() -> bytes:
    data = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        data, {"descr": "<f4", "fortran_order": False, "shape": (1 << 20, 1 << 20)}
    )
    return data.getvalue()


@pytest.mark.parametrize(
    ("name", "data"),
    [("a.png", _png(9000, 9000)), ("a.tif", _tiff()), ("a.npy", _npy()), ("b.png", _png(0, 5))],
)
def test_a_size_that_a_header_states_is_checked_before_memory_is_taken(tmp_path, name, data):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(InputError, match=r"Cannot read .*: (it|its header) states|Cannot read"):
        read_rgb(tmp_path / name)


def test_damaged_files_are_one_line(tmp_path):
    """Pillow raises SyntaxError for a chunk of a PNG, NumPy TokenError for a header."""
    image = io.BytesIO()
    _picture().convert("P").save(image, "PNG")
    broken = bytearray(image.getvalue())
    broken[broken.index(b"PLTE")] = 0xFF
    for name, data in (
        ("a.png", bytes(broken)),
        ("b.npy", b"\x93NUMPY\x01\x00\x08\x00{'descr("),
        ("c.npy", b""),
        ("d.jpg", b"\xff\xd8\xff"),
        ("e.tif", b"II*\0\x08\0\0\0\xff\xff"),
    ):
        (tmp_path / name).write_bytes(data)
        with pytest.raises(InputError, match=f"Cannot read .*{name}") as error:
            read_rgb(tmp_path / name)
        assert "\n" not in str(error.value)


def test_photographs_of_a_folder_are_without_hidden_files(tmp_path):
    """As `vrcaps calibrate` and `vrcaps organ texture` read them."""
    _picture().save(tmp_path / "a.jpg")
    (tmp_path / "._a.jpg").write_bytes(b"\0\5\x16\7")
    (tmp_path / "Thumbs.db").write_bytes(b"")
    assert [photo.name for photo in read_photos([tmp_path])] == ["a.jpg"]
    assert jpeg_quality([tmp_path]) == 75


@pytest.mark.parametrize("read", [read_rgb, image_size])
def test_postscript_under_the_name_of_a_picture_is_not_run(
    read: Callable[[Path], object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Pillow would start Ghostscript, a program, on data of others."""
    program = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 8 8\n%%EndComments\nshowpage\n%%EOF\n"
    (tmp_path / "a.png").write_bytes(program)
    monkeypatch.setattr(subprocess, "check_call", lambda *_, **__: pytest.fail("a program ran"))
    with pytest.raises(InputError, match=r"a\.png"):
        read(tmp_path / "a.png")
