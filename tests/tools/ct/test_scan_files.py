"""DICOM folders and image files become the scan they were written from."""

import locale
import shutil
import sys
from dataclasses import replace

import numpy as np
import pytest
import SimpleITK as sitk

from tests.support.phantom import write_dicom
from vrcaps.core.errors import InputError, MissingExtraError
from vrcaps.tools.ct import scan_files, volume
from vrcaps.tools.ct.lumen import choose_gas, find_gas
from vrcaps.tools.ct.scan_files import read_volume
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
        InputError, match=r"contains 2 series.*1: 'series 1' CT 12×16×6; 2: 'series 2'"
    ):
        read_volume(tmp_path)
    assert np.array_equal(read_volume(tmp_path, series="2").values, other.values)
    uid = "1.2.826.0.1.3680043.9999.1"
    assert np.array_equal(read_volume(tmp_path, series=uid).values, scan.values)
    with pytest.raises(InputError, match=r"No unique series '3' in .* Allowed: 1: 'series 1'"):
        read_volume(tmp_path, series="3")


def test_missing_slices_are_named(tmp_path) -> None:
    paths = write_dicom(tmp_path, small(num=9))
    paths[4].unlink()
    paths[5].unlink()
    with pytest.raises(InputError, match=r"About 2 slices are missing .* 3\.75 mm between"):
        read_volume(tmp_path)


def test_duplicate_slices_are_named(tmp_path) -> None:
    write_dicom(tmp_path, small())
    other = small()
    write_dicom(tmp_path / "other", replace(other, values=other.values + 1), first=50)
    again = sorted((tmp_path / "other").iterdir())[2]
    data = again.read_bytes().replace(b"9999.1.", b"9999.7.")  # instances of their own
    (tmp_path / "again.dcm").write_bytes(data)
    shutil.rmtree(tmp_path / "other")
    with pytest.raises(InputError, match="have the same position"):
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
        ((30_000, 30_000, 3), r"states 2\.7e\+09 voxels\. Allowed: up to 1\.07e\+09"),
        ((1000, 1000, 100), r"is truncated: its header states 1e\+08 voxels, but it has \d+ bytes"),
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


@pytest.mark.parametrize(
    ("spacing", "match"),
    [
        (0.0, r"its header states voxels of \[0\.0, 1\.0, 1\.0\] mm"),
        (np.nan, r"its header states voxels of \[nan, 1\.0, 1\.0\] mm"),
        (1e6, r"states voxels of 1e\+06 × 1 × 1 mm\. Allowed: sides from 1 µm, and .* up to 10 m"),
        (1e-6, r"states voxels of 1e-06 × 1 × 1 mm"),
    ],
)
def test_a_nifti_without_a_plausible_scale_is_refused(tmp_path, spacing, match) -> None:
    path = tmp_path / "scan.nii"
    sitk.WriteImage(sitk.GetImageFromArray(np.zeros((4, 5, 6), np.int16)), str(path))
    data = bytearray(path.read_bytes())
    data[80:84] = np.array(spacing, "<f4").tobytes()
    data[254:256] = np.zeros(1, "<i2").tobytes()  # no affine map, which states a scale as well
    path.write_bytes(data)
    with pytest.raises(InputError, match=match):
        read_volume(path)


def test_a_slice_of_too_many_pixels_is_refused_unread(tmp_path, monkeypatch) -> None:
    write_dicom(tmp_path, small())
    monkeypatch.setattr(scan_files, "_MAX_PIXELS", 15)
    monkeypatch.setattr(scan_files, "_read_pixels", lambda path: pytest.fail("read"))
    with pytest.raises(InputError, match=r"have 12 × 16 pixels. Allowed: sides up to 15"):
        read_volume(tmp_path)


def test_files_of_several_images_are_refused_unread(tmp_path, monkeypatch) -> None:
    write_dicom(tmp_path, small())
    found = scan_files.list_series(tmp_path)
    found = replace(found, series=tuple(replace(one, frames=500) for one in found.series))
    monkeypatch.setattr(scan_files, "list_series", lambda folder: found)
    monkeypatch.setattr(scan_files, "_read_pixels", lambda path: pytest.fail("read"))
    with pytest.raises(InputError, match=r"multi-frame DICOM of 500 images"):
        read_volume(tmp_path)


def test_a_series_of_too_many_voxels_is_refused(tmp_path, monkeypatch) -> None:
    write_dicom(tmp_path, small())
    monkeypatch.setattr(volume, "_MAX_VOXELS", 1000)
    with pytest.raises(InputError, match=r"states 1\.15e\+03 voxels"):
        read_volume(tmp_path)


def write_values(path, values) -> None:
    image = sitk.GetImageFromArray(values)
    image.SetSpacing((1.5, 1.5, 2.0))
    sitk.WriteImage(image, str(path))


@pytest.mark.parametrize(
    ("kind", "given", "expected"),
    [
        (np.float32, [40_000.0, -950.4, 32_767.6], [32_767, -950, 32_767]),
        (np.float64, [1e20, -1e20, 0.6], [32_767, -32_768, 1]),
        (np.int32, [65_536, -65_536, 7], [32_767, -32_768, 7]),
        (np.uint16, [65_535, 40_000, 0], [32_767, 32_767, 0]),
        (np.uint8, [255, 128, 0], [255, 128, 0]),
    ],
)
def test_hounsfield_units_never_wrap(tmp_path, kind, given, expected) -> None:
    values = np.zeros((4, 4, 4), kind)
    values[0, 0, :3] = given
    write_values(tmp_path / "scan.nii", values)
    assert read_volume(tmp_path / "scan.nii").values[0, 0, :3].tolist() == expected


@pytest.mark.parametrize("bad", [np.nan, -np.inf])
@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize("suffix", [".nii", ".nii.gz", ".nrrd", ".mha"])
def test_voxels_that_are_not_finite_are_counted(tmp_path, bad, kind, suffix) -> None:
    """Also in NIfTI, where the library that reads it makes them 0, which is water."""
    values = np.zeros((4, 4, 4), kind)
    values[1, 2, 1:3] = bad
    write_values(tmp_path / f"scan{suffix}", values)
    for is_label_map in (False, True):
        with pytest.raises(InputError, match=r"2 (voxels|of the label IDs).* not (fin|all)"):
            read_volume(tmp_path / f"scan{suffix}", is_label_map=is_label_map)


def test_voxels_of_a_big_endian_nifti_are_checked(tmp_path) -> None:
    write_values(tmp_path / "scan.nii", np.zeros((4, 4, 4), np.float32))
    data = (tmp_path / "scan.nii").read_bytes()
    header = bytearray(data[:352])
    for start, size, count in [(0, 4, 1), (40, 2, 8), (68, 2, 4), (76, 4, 11), (252, 2, 2)]:
        part = np.frombuffer(bytes(header[start : start + size * count]), f"<i{size}")
        header[start : start + size * count] = part.astype(f">i{size}").tobytes()
    for start, count in [(256, 18)]:
        part = np.frombuffer(bytes(header[start : start + 4 * count]), "<i4")
        header[start : start + 4 * count] = part.astype(">i4").tobytes()
    values = np.zeros((4, 4, 4), ">f4")
    (tmp_path / "big.nii").write_bytes(bytes(header) + values.tobytes())
    assert (read_volume(tmp_path / "big.nii").values == 0).all()
    values[0, 0, 0] = np.nan
    (tmp_path / "big.nii").write_bytes(bytes(header) + values.tobytes())
    with pytest.raises(InputError, match="has 1 voxels that are not finite"):
        read_volume(tmp_path / "big.nii")


@pytest.mark.parametrize(
    ("kind", "given", "shown"),
    [
        (np.int32, 65_556, "65556"),
        (np.uint16, 40_000, "40000"),
        (np.float32, 1.6, "1.6"),
    ],
)
def test_label_numbers_are_whole_and_in_range(tmp_path, kind, given, shown) -> None:
    values = np.zeros((4, 4, 4), kind)
    values[0, 0, 0] = given
    write_values(tmp_path / "labels.nii", values)
    with pytest.raises(InputError, match=rf"label IDs of .* the first is {shown}\. Allowed"):
        read_volume(tmp_path / "labels.nii", is_label_map=True)
    values[0, 0, 0] = 20
    write_values(tmp_path / "labels.nii", values)
    assert read_volume(tmp_path / "labels.nii", is_label_map=True).values[0, 0, 0] == 20


def test_a_nifti_without_a_start_of_its_voxels_is_refused(tmp_path) -> None:
    write_values(tmp_path / "scan.nii", np.zeros((4, 4, 4), np.float32))
    data = bytearray((tmp_path / "scan.nii").read_bytes())
    data[108:112] = np.array([np.nan], "<f4").tobytes()
    (tmp_path / "scan.nii").write_bytes(data)
    with pytest.raises(InputError, match=r"Cannot read .*scan\.nii"):
        read_volume(tmp_path / "scan.nii")


def test_complex_values_are_no_scan(tmp_path) -> None:
    write_values(tmp_path / "scan.nii", np.zeros((4, 4, 4), np.complex64))
    with pytest.raises(InputError, match="4 × 4 × 4 voxels of 2 values"):
        read_volume(tmp_path / "scan.nii")
    with pytest.raises(InputError, match="values of type complex64"):
        volume.hounsfield(np.zeros(3, np.complex64), "made")


def test_a_prosthesis_is_no_gas() -> None:
    """A water cylinder with gas, and a rod of 40,000 HU: one piece of gas, the rod as metal."""
    k, j, i = np.mgrid[:40, :64, :64]
    values = np.full(k.shape, -1000.0)
    values[(j - 31.5) ** 2 + (i - 31.5) ** 2 < 28**2] = 40.0
    values[((j - 31.5) ** 2 + (i - 24) ** 2 < 8**2) & (k > 4) & (k < 35)] = -950.0
    values[((j - 31.5) ** 2 + (i - 50) ** 2 < 3**2) & (k > 5) & (k < 35)] = 40_000.0
    transform = np.diag([2e-3, 1.5e-3, 1.5e-3, 1.0])
    scan = Volume(volume.hounsfield(values, "made"), transform, "made")
    (piece,) = find_gas(scan).pieces
    assert piece.kind == "gut"
    count = np.count_nonzero(values == -950.0)
    assert piece.volume == pytest.approx(count * 4.5e-9)


def test_no_gas_states_the_range_of_values() -> None:
    j, i = np.mgrid[:64, :64]
    values = np.tile(
        np.where((j - 31.5) ** 2 + (i - 31.5) ** 2 < 28**2, 1064, 24), (20, 1, 1)
    ).astype(np.int16)
    scan = Volume(values, np.diag([2e-3, 1.5e-3, 1.5e-3, 1.0]), "made")
    with pytest.raises(InputError, match=r"The values go from 24 to 1064 HU\. Air has -1000 HU"):
        choose_gas(find_gas(scan), scan)
    scan = Volume(values - np.int16(1024), scan.T_patient_index, "made")
    with pytest.raises(InputError, match=r"from -1000 to 40 HU\. Change --threshold"):
        choose_gas(find_gas(scan), scan)


@pytest.mark.parametrize("suffix", [".nii", ".nii.gz"])
def test_a_nifti_of_integers_that_is_cut_short_is_refused(tmp_path, suffix) -> None:
    """ITK takes missing voxels for 0."""
    path = tmp_path / f"scan{suffix}"
    write_values(path, np.arange(4096, dtype=np.int16).reshape(16, 16, 16))
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(InputError, match=r"scan\.nii.*Copy the file again"):
        read_volume(path)


_META = (
    "ObjectType = Image\nNDims = 3\nDimSize = 2 2 2\nElementType = MET_UCHAR\nElementDataFile = "
)
_NRRD = "NRRD0004\ntype: uchar\ndimension: 3\nsizes: 2 2 2\nencoding: raw\n"


@pytest.mark.parametrize("name", ["../secret", "LIST\n../secret\n../secret\n"])
@pytest.mark.parametrize(
    ("suffix", "head", "end"),
    [
        (".mhd", _META, "\n"),
        (".mha", _META, "\n"),
        (".nrrd", f"{_NRRD}data file: ", "\n\n"),
        (".nrrd", f"{_NRRD}datafile: ", "\n\n"),
    ],
)
def test_a_header_names_no_file_outside_its_folder(tmp_path, suffix, head, end, name) -> None:
    (tmp_path / "secret").write_bytes(bytes(8))
    folder = tmp_path / "scans"
    folder.mkdir()
    path = folder / f"scan{suffix}"
    path.write_text(head + name + end)
    with pytest.raises(InputError, match=r"secret leads out of .*scans"):
        read_volume(path)
