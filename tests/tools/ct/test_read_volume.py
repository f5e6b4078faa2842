"""DICOM folders and image files become the scan they were written from."""

import locale
import shutil
import sys
from dataclasses import replace

import numpy as np
import pytest
import SimpleITK as sitk

from phantom import write_dicom
from vrcaps.errors import InputError, MissingExtraError
from vrcaps.tools.ct import read_dicom, volume
from vrcaps.tools.ct.read_volume import read_volume
from vrcaps.tools.ct.volume import Volume


def small(tilt: float = 0.0, num: int = 6) -> Volume:
    """An oblique scan, its slices shifted along j from one to the next as by a tilted gantry."""
    rng = np.random.default_rng(0)
    turn, _ = np.linalg.qr(np.eye(3) + 0.1 * rng.standard_normal((3, 3)))
    turn *= np.sign(np.diag(turn))
    turn[:, 2] *= np.sign(np.linalg.det(turn))
    transform = np.eye(4)
    transform[:3, :3] = turn[:, ::-1] * [1.25e-3, 0.7e-3, 0.7e-3]
    transform[:3, 0] += tilt * transform[:3, 1]
    transform[:3, 3] = 0.1, -0.2, 0.3
    return Volume(rng.integers(-1024, 2000, (num, 16, 12)).astype(np.int16), transform, "made")


@pytest.mark.parametrize("tilt", [0.0, 0.5])
@pytest.mark.parametrize("compressor", [None, "JPEG", "JPEG2000"])
def test_dicom_comes_back_with_its_values_and_place(tmp_path, tilt, compressor) -> None:
    scan = small(tilt)
    write_dicom(tmp_path / "series", scan, compressor=compressor)
    (tmp_path / "series" / "notes.txt").write_text("not DICOM")
    seen, before = [], locale.setlocale(locale.LC_ALL)
    found = read_volume(tmp_path, progress=lambda done, total: seen.append((done, total)))
    assert np.array_equal(found.values, scan.values)
    assert found.values.dtype == np.int16
    assert np.allclose(found.T_patient_index, scan.T_patient_index, atol=1e-8)
    assert seen == [(n + 1, 6) for n in range(6)]
    assert locale.setlocale(locale.LC_ALL) == before


def test_a_series_is_chosen_by_number_or_uid(tmp_path) -> None:
    scan, other = small(), small(num=4)
    write_dicom(tmp_path, scan, series="1")
    write_dicom(tmp_path, other, series="2", first=50)
    with pytest.raises(
        InputError, match=r"holds 2 series.*1: 'series 1' CT 12×16×6; 2: 'series 2'"
    ):
        read_volume(tmp_path)
    assert np.array_equal(read_volume(tmp_path, series="2").values, other.values)
    uid = "1.2.826.0.1.3680043.9999.1"
    assert np.array_equal(read_volume(tmp_path, series=uid).values, scan.values)
    with pytest.raises(InputError, match=r"No one series '3' in .* Allowed: 1: 'series 1'"):
        read_volume(tmp_path, series="3")


def test_missing_slices_are_named(tmp_path) -> None:
    paths = write_dicom(tmp_path, small(num=9))
    paths[4].unlink()
    paths[5].unlink()
    with pytest.raises(InputError, match=r"About 2 slices are missing .* 3\.75 mm between"):
        read_volume(tmp_path)


def test_duplicate_slices_are_named(tmp_path) -> None:
    paths = write_dicom(tmp_path, small())
    shutil.copy(paths[2], tmp_path / "again.dcm")
    with pytest.raises(InputError, match="lie at one place"):
        read_volume(tmp_path)


def test_slices_beside_their_place_are_refused(tmp_path) -> None:
    write_dicom(tmp_path, small(num=7))
    moved = small(num=7)
    moved.T_patient_index[:3, 3] += 20 * moved.T_patient_index[:3, 1]
    for path in write_dicom(tmp_path / "x", moved)[3:4]:
        shutil.copy(path, tmp_path / path.name)
    shutil.rmtree(tmp_path / "x")
    with pytest.raises(InputError, match="unevenly spaced"):
        read_volume(tmp_path)


def test_what_is_no_ct_series_is_refused(tmp_path) -> None:
    with pytest.raises(InputError, match="No DICOM slice in"):
        read_volume(tmp_path)
    write_dicom(tmp_path / "mr", small(), modality="MR")
    with pytest.raises(InputError, match="is MR, not CT"):
        read_volume(tmp_path / "mr")
    write_dicom(tmp_path / "one", small(num=1))
    with pytest.raises(InputError, match="is a single slice"):
        read_volume(tmp_path / "one")


def test_a_damaged_slice_is_named(tmp_path) -> None:
    path = write_dicom(tmp_path, small(), compressor="JPEG2000")[3]
    data = path.read_bytes()
    start = data.index(b"\xff\x4f\xff\x51")  # of the JPEG 2000 stream
    path.write_bytes(data[: start + 4] + bytes(len(data) - start - 4))
    with pytest.raises(InputError, match=f"Cannot read DICOM slice .*{path.name}"):
        read_volume(tmp_path)


@pytest.mark.parametrize("suffix", [".nii.gz", ".nrrd", ".mha"])
def test_files_come_back_with_their_values_and_place(tmp_path, suffix) -> None:
    scan = small()
    image = sitk.GetImageFromArray(scan.values)
    image.SetSpacing((scan.spacing[::-1] * 1e3).tolist())
    image.SetOrigin((scan.T_patient_index[:3, 3] * 1e3).tolist())
    direction = scan.T_patient_index[:3, :3] / scan.spacing
    image.SetDirection(direction[:, ::-1].ravel().tolist())
    flipped = image[::-1, :, ::-1]
    path = tmp_path / f"scan{suffix}"
    sitk.WriteImage(flipped, str(path))
    found = read_volume(path)
    assert np.array_equal(found.values, scan.values)
    assert np.allclose(found.T_patient_index, scan.T_patient_index, atol=1e-6)


def test_files_that_are_no_scan_are_refused(tmp_path) -> None:
    with pytest.raises(InputError, match="No scan at"):
        read_volume(tmp_path / "absent.nii")
    (tmp_path / "scan.pdf").touch()
    with pytest.raises(InputError, match=r"Unknown type of scan 'scan\.pdf'"):
        read_volume(tmp_path / "scan.pdf")
    (tmp_path / "bad.nii").write_bytes(b"not an image")
    with pytest.raises(InputError, match=r"Cannot read .*bad\.nii"):
        read_volume(tmp_path / "bad.nii")
    sitk.WriteImage(sitk.Image(4, 5, sitk.sitkInt16), str(tmp_path / "flat.nii"))
    with pytest.raises(InputError, match="Give one three-dimensional scan"):
        read_volume(tmp_path / "flat.nii")


def test_without_simpleitk_the_extra_is_named(tmp_path, monkeypatch) -> None:
    (tmp_path / "scan.nii").touch()
    monkeypatch.setitem(sys.modules, "SimpleITK", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'vrcaps\[ct\]'"):
        read_volume(tmp_path / "scan.nii")


@pytest.mark.parametrize(
    ("size", "match"),
    [
        ((30_000, 30_000, 3), r"says that it holds 2\.7e\+09 voxels\. Allowed: up to 1\.07e\+09"),
        ((1000, 1000, 100), r"is cut short: it says 1e\+08 voxels and has \d+ bytes"),
    ],
)
def test_a_nifti_that_says_too_much_is_refused_before_it_is_read(tmp_path, size, match) -> None:
    path = tmp_path / "scan.nii"
    sitk.WriteImage(sitk.GetImageFromArray(np.zeros((4, 5, 6), np.int16)), str(path))
    data = bytearray(path.read_bytes())
    data[42:48] = np.array(size, "<i2").tobytes()
    path.write_bytes(data)
    with pytest.raises(InputError, match=match):
        read_volume(path)


def test_a_slice_of_too_many_pixels_is_refused_unread(tmp_path, monkeypatch) -> None:
    write_dicom(tmp_path, small())
    monkeypatch.setattr(read_dicom, "_MOST_PIXELS", 15)
    monkeypatch.setattr(read_dicom, "_read_pixels", lambda path: pytest.fail("read"))
    with pytest.raises(InputError, match=r"have 12 × 16 pixels. Allowed: sides up to 15"):
        read_volume(tmp_path)


def test_files_of_several_images_are_refused_unread(tmp_path, monkeypatch) -> None:
    write_dicom(tmp_path, small())
    found = [replace(one, frames=500) for one in read_dicom.list_series(tmp_path)]
    monkeypatch.setattr(read_dicom, "list_series", lambda folder: found)
    monkeypatch.setattr(read_dicom, "_read_pixels", lambda path: pytest.fail("read"))
    with pytest.raises(InputError, match=r"hold 500 images each\. Allowed: 1"):
        read_volume(tmp_path)


def test_a_series_of_too_many_voxels_is_refused(tmp_path, monkeypatch) -> None:
    write_dicom(tmp_path, small())
    monkeypatch.setattr(volume, "_MOST_VOXELS", 1000)
    with pytest.raises(InputError, match=r"says that it holds 1\.15e\+03 voxels"):
        read_volume(tmp_path)
