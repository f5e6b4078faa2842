import numpy as np
import pytest

from vrcaps.recording.image_files import read_image, write_images


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
