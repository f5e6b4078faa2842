"""PNG files of the core: exact, whole, and what other readers see."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from vrcaps import _core

SHAPES = [(1, 1), (7, 13), (64, 48), (1, 1, 3), (7, 13, 3), (64, 48, 3)]


def _image(rng: np.random.Generator, dtype: type, shape: tuple[int, ...]) -> np.ndarray:
    top = np.iinfo(dtype).max
    smooth = np.linspace(0, top, int(np.prod(shape))).reshape(shape)
    noisy = rng.integers(0, top, shape, endpoint=True)
    return np.where(rng.random(shape) < 0.5, smooth, noisy).astype(dtype)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("shape", SHAPES)
def test_round_trip(rng: np.random.Generator, tmp_path: Path, dtype: type, shape: tuple) -> None:
    import cv2

    image, path = _image(rng, dtype, shape), str(tmp_path / "image.png")
    _core.write_pngs([(path, image)])
    back = _core.read_png(path)
    assert back.dtype == dtype
    np.testing.assert_array_equal(back, image)
    theirs = cv2.imread(path, cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(theirs[..., ::-1] if image.ndim == 3 else theirs, image)
    assert [file.name for file in tmp_path.iterdir()] == ["image.png"]


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("shape", [(9, 6), (9, 6, 3)])
def test_reads_files_of_others(rng: np.random.Generator, tmp_path: Path, dtype: type, shape: tuple):
    import cv2

    image, path = _image(rng, dtype, shape), str(tmp_path / "image.png")
    assert cv2.imwrite(path, image[..., ::-1] if image.ndim == 3 else image)
    np.testing.assert_array_equal(_core.read_png(path), image)


def test_encoded_and_decoded_in_memory(rng: np.random.Generator) -> None:
    images = [_image(rng, dtype, shape) for dtype in (np.uint8, np.uint16) for shape in SHAPES]
    files = _core.encode_pngs(images)
    back = _core.decode_pngs([np.frombuffer(file, np.uint8) for file in files])
    for image, found in zip(images, back, strict=True):
        assert found.dtype == image.dtype
        np.testing.assert_array_equal(found, image)
    with pytest.raises(ValueError, match="uint8 or uint16"):
        _core.encode_pngs([np.zeros((4, 4))])
    with pytest.raises(ValueError, match="shape"):
        _core.encode_pngs([np.zeros((4, 4, 2), np.uint8)])
    with pytest.raises(ValueError, match=r"(?i)end|eof|format|signature"):
        _core.decode_pngs([np.frombuffer(files[-1][:20], np.uint8)])


def test_arrays_need_not_be_contiguous(rng: np.random.Generator, tmp_path: Path) -> None:
    image, path = _image(rng, np.uint16, (20, 30, 3)), str(tmp_path / "image.png")
    _core.write_pngs([(path, image[::-2, 3::4])])
    np.testing.assert_array_equal(_core.read_png(path), image[::-2, 3::4])


def test_many_at_once_overwrite_what_was_there(rng: np.random.Generator, tmp_path: Path) -> None:
    images = [_image(rng, np.uint8, (33, 21, 3)) for _ in range(24)]
    paths = [str(tmp_path / f"{k:06d}.png") for k in range(24)]
    for shift in (1, 0):
        _core.write_pngs(list(zip(paths, images[shift:] + images[:shift], strict=True)))
    for path, image in zip(paths, images, strict=True):
        np.testing.assert_array_equal(_core.read_png(path), image)
    assert len(list(tmp_path.iterdir())) == 24


def test_the_same_image_makes_the_same_bytes(rng: np.random.Generator, tmp_path: Path) -> None:
    image = _image(rng, np.uint16, (50, 70))
    paths = [tmp_path / "one.png", tmp_path / "two.png"]
    _core.write_pngs([(str(path), image) for path in paths])
    assert paths[0].read_bytes() == paths[1].read_bytes()


def test_a_folder_that_is_not_there(tmp_path: Path) -> None:
    path = tmp_path / "missing" / "image.png"
    with pytest.raises(FileNotFoundError, match="No such file or directory") as caught:
        _core.write_pngs([(str(path), np.zeros((4, 4), np.uint8))])
    assert str(path) in str(caught.value)
    with pytest.raises(FileNotFoundError, match=str(path)):
        _core.read_png(str(path))


def test_what_cannot_be_written_leaves_no_trace(tmp_path: Path) -> None:
    """A folder in the file's place: the temporary file goes, the folder stays."""
    path = tmp_path / "image.png"
    path.mkdir()
    with pytest.raises(OSError, match=str(path)):
        _core.write_pngs([(str(path), np.zeros((4, 4), np.uint8))])
    assert [entry.name for entry in tmp_path.iterdir()] == ["image.png"]


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.zeros((4, 4), np.float32), "must be uint8 or uint16"),
        (np.zeros((4, 4), np.int32), "must be uint8 or uint16"),
        (np.zeros((4, 4, 4), np.uint8), r"must be of shape \(h, w\) or \(h, w, 3\)"),
        (np.zeros(4, np.uint16), r"must be of shape \(h, w\) or \(h, w, 3\)"),
    ],
)
def test_other_arrays_are_refused(tmp_path: Path, image: np.ndarray, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        _core.write_pngs([(str(tmp_path / "image.png"), image)])
    assert not list(tmp_path.iterdir())


def test_broken_files_are_refused(rng: np.random.Generator, tmp_path: Path) -> None:
    path = tmp_path / "image.png"
    _core.write_pngs([(str(path), _image(rng, np.uint8, (30, 30)))])
    whole = path.read_bytes()
    for broken in (b"", b"no image", whole[:100], whole[: len(whole) // 2]):
        path.write_bytes(broken)
        with pytest.raises(ValueError, match=str(path)):
            _core.read_png(str(path))


def test_empty_images_are_refused(tmp_path: Path) -> None:
    with pytest.raises((ValueError, OSError), match=r"image\.png"):
        _core.write_pngs([(str(tmp_path / "image.png"), np.zeros((0, 4), np.uint8))])
    assert not list(tmp_path.iterdir())
