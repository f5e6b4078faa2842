"""Odd DICOM files are skipped and named; values keep their meaning whatever the header says."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.support import small_dicom as tag
from tests.support.small_dicom import Elements, slice_elements, write_elements
from vrcaps.core.errors import InputError
from vrcaps.tools.ct.scan_files import read_volume

NUM = 12
HOUNSFIELD = np.random.default_rng(0).integers(-1000, 1500, (NUM, 8, 6)).astype(np.int32)


def series(
    folder: Path, change: Callable[[Elements, int], object] = lambda elements, number: None
) -> list[Path]:
    """Write a series of slices, the elements of each changed."""
    paths = []
    for number, values in enumerate(HOUNSFIELD):
        elements = slice_elements(values, number)
        change(elements, number)
        paths.append(write_elements(folder / f"{number:02}.dcm", elements))
    return paths


def first(**values: str) -> Callable[[Elements, int], None]:
    """Change of decimal strings of the first slice alone."""

    def change(elements: Elements, number: int) -> None:
        for name, text in values.items():
            if number == 0:
                elements[getattr(tag, name)] = ("DS", text)

    return change


def test_a_plain_series(tmp_path: Path) -> None:
    series(tmp_path)
    found = read_volume(tmp_path)
    assert np.array_equal(found.values, HOUNSFIELD)
    assert np.allclose(found.spacing, [2e-3, 1.5e-3, 1.5e-3])
    assert found.notes == ()


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (first(POSITION=""), "no position"),
        (first(POSITION="1\\2"), "position is 1\\2"),
        (first(POSITION="nan\\0\\0"), "position is nan\\0\\0"),
        (first(ORIENTATION=""), "no orientation"),
        (first(ORIENTATION="1\\0\\0\\1\\0\\0"), "orientation is not a pair of perpendicular"),
        (first(ORIENTATION="2\\0\\0\\0\\1\\0"), "orientation is not a pair of perpendicular"),
        (first(ORIENTATION="1\\0\\0\\0\\0\\-1"), "size or orientation differs"),
        (first(SPACING=""), "no pixel spacing"),
        (first(SPACING="0\\1.5"), "pixel spacing is not positive"),
        (first(SPACING="1\\1"), "size or orientation differs"),
    ],
)
def test_an_odd_file_is_skipped_and_named(tmp_path: Path, change, reason: str) -> None:
    series(tmp_path, change)
    found = read_volume(tmp_path)
    assert np.array_equal(found.values, HOUNSFIELD[1:])
    (note,) = found.notes
    assert note.startswith(f"1 DICOM file skipped: 00.dcm ({reason}")


def test_files_that_are_no_slices_are_passed_over_or_skipped(tmp_path: Path) -> None:
    paths = series(tmp_path)
    (tmp_path / "._00.dcm").write_bytes(b"\0\5\x16\7" + bytes(200))
    (tmp_path / ".00.dcm").write_bytes(paths[0].read_bytes())
    (tmp_path / "DICOMDIR").write_bytes(bytes(128) + b"DICM" + bytes(40))
    (tmp_path / "notes.txt").write_text("no DICOM")
    (tmp_path / "empty.dcm").touch()
    shutil.copy(paths[3], tmp_path / "30.dcm")
    (tmp_path / "40.dcm").write_bytes(paths[4].read_bytes()[:600])
    color = slice_elements(HOUNSFIELD[0], 99) | {tag.SAMPLES: ("US", 3)}
    color |= {tag.PHOTOMETRIC: ("CS", "RGB"), (0x0028, 0x0006): ("US", 0)}
    color |= {tag.BITS: ("US", 8), tag.STORED: ("US", 8), tag.HIGH_BIT: ("US", 7)}
    color[tag.PIXELS] = ("OW", bytes(8 * 6 * 3))
    write_elements(tmp_path / "50.dcm", color)
    report = slice_elements(HOUNSFIELD[0], 98) | {
        tag.SOP_CLASS: ("UI", "1.2.840.10008.5.1.4.1.1.88.11")
    }
    del report[tag.PIXELS]
    write_elements(tmp_path / "60.dcm", report)
    found = read_volume(tmp_path)
    assert np.array_equal(found.values, HOUNSFIELD)
    assert found.notes == (
        "4 DICOM files skipped: 30.dcm (copy of 03.dcm), 40.dcm (not an image, or damaged), "
        "50.dcm (color image), …",
    )


def test_a_slice_that_is_missed_names_the_file_that_was_skipped(tmp_path: Path) -> None:
    def change(elements: Elements, number: int) -> None:
        if number == 5:
            elements[tag.POSITION] = ("DS", "")

    series(tmp_path, change)
    with pytest.raises(
        InputError,
        match=r"About 1 slice is missing in .*: 4\.00 mm between 04\.dcm and 06\.dcm, elsewhere "
        r"2\.00 mm\. Give the whole series\. 1 DICOM file skipped: 05\.dcm \(no position\)\.$",
    ):
        read_volume(tmp_path)


def test_only_skipped_files(tmp_path: Path) -> None:
    write_elements(
        tmp_path / "00.dcm", slice_elements(HOUNSFIELD[0], 0) | {tag.POSITION: ("DS", "")}
    )
    with pytest.raises(InputError, match=r"No DICOM slice in .* skipped: 00\.dcm \(no position\)"):
        read_volume(tmp_path)


def test_noise_of_the_cosines_does_not_split_a_series(tmp_path: Path) -> None:
    """About the border of rounding to three digits."""

    def change(elements: Elements, number: int) -> None:
        e = 0.0005 + (1e-7 if number % 2 else -1e-7)
        elements[tag.ORIENTATION] = ("DS", f"1\\{e:.8f}\\0\\{-e:.8f}\\1\\0")

    series(tmp_path, change)
    assert np.array_equal(read_volume(tmp_path).values, HOUNSFIELD)


def test_two_orientations_are_two_series(tmp_path: Path) -> None:
    def change(elements: Elements, number: int) -> None:
        if number >= NUM // 2:
            elements[tag.ORIENTATION] = ("DS", "1\\0\\0\\0\\0\\-1")
            elements[tag.POSITION] = ("DS", f"-6\\{2 * number}\\0")

    series(tmp_path, change)
    with pytest.raises(InputError, match="contains 2 series"):
        read_volume(tmp_path)
    assert len(read_volume(tmp_path, series="1").notes) == 0


def test_every_second_slice_is_told(tmp_path: Path) -> None:
    for path in series(tmp_path)[1::2]:
        path.unlink()
    (note,) = read_volume(tmp_path).notes
    assert note.startswith("slices are 4.00 mm apart and 2.00 mm thick: slices may be missing")


def test_a_step_that_changes_is_refused(tmp_path: Path) -> None:
    """From 2 to 2.5 mm half-way: the middle slice lies 1.36 mm beside the line through the ends."""

    def change(elements: Elements, number: int) -> None:
        height = 2.0 * number if number < NUM // 2 else 2.0 * number + 0.5 * (number - NUM // 2)
        elements[tag.POSITION] = ("DS", f"-6\\-6\\{height}")

    series(tmp_path, change)
    with pytest.raises(InputError, match=r"unevenly spaced: 06\.dcm lies 1\.36 mm from its"):
        read_volume(tmp_path)


def test_a_multiframe_file_names_a_converter(tmp_path: Path) -> None:
    elements = slice_elements(HOUNSFIELD.reshape(-1, 6), 0)
    elements |= {tag.FRAMES: ("IS", str(NUM)), tag.ROWS: ("US", 8)}
    elements[tag.SOP_CLASS] = ("UI", "1.2.840.10008.5.1.4.1.1.2.1")
    del elements[tag.POSITION], elements[tag.ORIENTATION]
    write_elements(tmp_path / "one.dcm", elements)
    with pytest.raises(
        InputError, match=r"one\.dcm in .* multi-frame DICOM of 12 images.*dcm2niix"
    ):
        read_volume(tmp_path)


@pytest.mark.parametrize(("bits", "is_signed"), [(16, False), (12, False), (16, True)])
def test_monochrome1_states_how_values_are_shown_not_what_they_mean(
    tmp_path: Path, bits: int, is_signed: bool
) -> None:
    def change(elements: Elements, number: int) -> None:
        elements[tag.PHOTOMETRIC] = ("CS", "MONOCHROME1")
        elements |= {tag.STORED: ("US", bits), tag.HIGH_BIT: ("US", bits - 1)}
        if is_signed:
            elements |= {tag.SIGNED: ("US", 1), tag.INTERCEPT: ("DS", "0")}
            stored = HOUNSFIELD[number] & (2**bits - 1)
            elements[tag.PIXELS] = ("OW", stored.astype("<u2").tobytes())

    series(tmp_path, change)
    assert np.array_equal(read_volume(tmp_path).values, HOUNSFIELD)


def test_each_slice_has_its_own_rescale(tmp_path: Path) -> None:
    def change(elements: Elements, number: int) -> None:
        slope = 0.5 * (1 + number % 3)
        stored = np.rint((HOUNSFIELD[number] + 1024) / slope)
        elements |= {
            tag.SLOPE: ("DS", f"{slope}"),
            tag.PIXELS: ("OW", stored.astype("<u2").tobytes()),
        }

    series(tmp_path, change)
    assert np.abs(read_volume(tmp_path).values - HOUNSFIELD).max() <= 1


def test_metal_stays_dense(tmp_path: Path) -> None:
    def change(elements: Elements, number: int) -> None:
        elements[tag.PIXELS] = ("OW", np.full((8, 6), 60_000, "<u2").tobytes())

    series(tmp_path, change)
    assert (read_volume(tmp_path).values == 32_767).all()
