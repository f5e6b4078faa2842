"""Comparison of sets: equal sets are near, other ones far; page, sheet and command."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from vrcaps.cli import main
from vrcaps.core.errors import InputError
from vrcaps.tools.appearance.compare import (
    HAND,
    DescribedSet,
    blind_sheet,
    compare,
    halves,
    nearest_to,
    rows_of,
    write_report,
)
from vrcaps.tools.appearance.views import LEVELS, SIDE, STATISTICS, ImageSet


def described(name: str, count: int, shift: float, seed: int) -> DescribedSet:
    rng = np.random.default_rng(seed)
    features = {level: shift + rng.standard_normal((count, 40)) for level in LEVELS}
    features[HAND] = shift + rng.standard_normal((count, len(STATISTICS)))
    views = np.full((count, SIDE, SIDE, 3), int(100 + 20 * shift), np.uint8)
    groups = np.array([f"{k % 6}" for k in range(count)])
    names = tuple(f"{name}/{k}" for k in range(count))
    return DescribedSet(ImageSet(name, views, groups, names), features)


@pytest.fixture
def real() -> DescribedSet:
    return described("real", 60, 0.0, 0)


def test_the_nearer_set_has_the_smaller_distance_and_larger_coverage(real: DescribedSet):
    near, far = compare(real, [described("near", 50, 0.1, 1), described("far", 50, 2.0, 2)])
    for level in (HAND, *LEVELS):
        assert near.distances[level].value < far.distances[level].value
    assert near.frechet < far.frechet
    assert near.coverage > far.coverage
    assert not near.outside
    assert len(far.outside) == 11


def test_halves_share_no_group_and_hold_all_images(real: DescribedSet):
    first, second = halves(real)
    assert not set(first.images.groups) & set(second.images.groups)
    assert len(first.images) + len(second.images) == 60


def test_nearest_images_of_a_copy_are_themselves(real: DescribedSet):
    pairs = nearest_to(real, real, 10)
    np.testing.assert_array_equal(pairs[:, 0], pairs[:, 1])


def test_the_blind_sheet_holds_each_image_once(real: DescribedSet):
    ours = described("ours", 40, 4.0, 1)
    sheet, answers = blind_sheet(real, ours)
    assert sorted(answers["real"] + answers["ours"]) == list(range(1, 49))
    step, gap = SIDE + 6, 6
    for number in range(1, 49):
        row, column = divmod(number - 1, 8)
        value = sheet[gap + row * step + 5, gap + column * step + 5, 0]
        assert value == (100 if number in answers["real"] else 180)


def test_the_report_states_all_sets(real: DescribedSet, tmp_path: Path):
    ours = described("ours", 40, 1.0, 1)
    results = compare(real, [ours])
    rows = rows_of(results, 0.5 * results[0].pooled)
    write_report(tmp_path, real, ours, results, rows)
    assert rows[0]["R"] == "2.00"
    page = (tmp_path / "index.html").read_text()
    assert all(name in page for name in ("ours", "real", "spectrum", "Nearest images"))
    with Image.open(tmp_path / "blind.png") as sheet:
        assert sheet.size[0] > 8 * SIDE
    assert set(json.loads((tmp_path / "blind_answers.json").read_text())) == {"real", "ours"}


def write_images(folder: Path, count: int, level: int) -> Path:
    """Images of one brightness that differ in color and in size of their structure."""
    rng = np.random.default_rng(level)
    folder.mkdir()
    for k in range(count):
        cells, spread = int(rng.integers(2, 40)), rng.uniform(5.0, 60.0, 3)
        image = level + spread * rng.uniform(-1.0, 1.0, (cells, cells, 3))
        small = Image.fromarray(np.clip(image, 30, 255).astype(np.uint8))
        small.resize((96, 96), Image.Resampling.NEAREST).save(folder / f"{k}.png")
    return folder


@pytest.mark.slow
def test_the_command_compares_folders(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    real = write_images(tmp_path / "real", 20, 100)
    near, far = write_images(tmp_path / "near", 8, 101), write_images(tmp_path / "far", 8, 220)
    out = tmp_path / "out"
    options = ["--other", f"near={near}", "--second-real", str(near), "--out", str(out)]
    main(["compare-looks", str(far), str(real), *options])
    rows = (out / "looks.csv").read_text().splitlines()
    values = {row.split(",")[0]: row.split(",") for row in rows[1:]}
    column = rows[0].split(",").index("KID pooled")
    distance = {name: float(row[column].split("±")[0]) for name, row in values.items()}
    assert distance["ours"] > 2.0 * distance["near"]
    assert distance["ours"] > 2.0 * distance["halves of the real set"]
    printed = capsys.readouterr().out
    assert "Blind sheet" in printed
    assert "Few images: ours 8, near 8, second real 8." in printed
    assert "halves of" in (out / "index.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("text", ["near", "=folder", "near=", " = "])
def test_a_further_set_needs_a_name_and_a_source(
    text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    real = write_images(tmp_path / "real", 3, 60)
    with pytest.raises(SystemExit) as stopped:
        main(["compare-looks", str(real), str(real), "--other", text])
    assert stopped.value.code == 2
    assert f"--other is {text!r}. Allowed: NAME=SOURCE" in capsys.readouterr().err


def test_sets_of_two_images_are_refused():
    with pytest.raises(InputError, match="number of images is 2"):
        compare(described("real", 20, 0.0, 0), [described("ours", 2, 0.0, 1)])


@pytest.mark.slow
def test_a_reference_of_copies_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    folder = tmp_path / "copies"
    folder.mkdir()
    for k in range(15):
        Image.new("RGB", (64, 64), (180, 120, 90)).save(folder / f"{k}.png")
    with pytest.raises(SystemExit):
        main(["compare-looks", str(folder), str(folder)])
    message = (
        "The set real has 1 images without near-duplicates, and one of its halves has 0. Allowed"
    )
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--seed", "-1"], "--seed is -1. Allowed: 0 to 18446744073709551615."),
        (["--max-images", "5"], "--max-images is 5. Allowed: 12 or more."),
        (["--other", "a=.", "--other", "a=."], "the name 'a' is taken. Give another name."),
        (["--other", "meaning=."], "the name 'meaning' is taken"),
        (["--other", "real =."], "the name 'real' is taken"),
        (
            ["--out", "looks"],
            "--out is looks, in the folder . that is read. Allowed: a folder else",
        ),
        (["--out", "../a/out"], "--out is ../a/out: cannot create its parent (File exists)."),
    ],
)
def test_invalid_options_are_one_line(
    options: list[str],
    message: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
):
    real = write_images(tmp_path / "real", 3, 60)
    (tmp_path / "a").write_text("")
    monkeypatch.chdir(real)
    with pytest.raises(SystemExit):
        main(["compare-looks", ".", ".", *options])
    error = capsys.readouterr().err
    assert message in error
    assert len(error.splitlines()) == 1


def test_halves_of_unequal_patients_are_refused(real: DescribedSet):
    images = real.images
    groups = np.array(["a"] + ["b"] * 59)
    uneven = DescribedSet(ImageSet("real", images.views, groups, images.names), real.features)
    with pytest.raises(InputError, match=r"60 images .* of 2 patients or folders, .* halves has 1"):
        halves(uneven)


@pytest.mark.parametrize("unit", [0.0, -0.25, None])
def test_a_second_real_set_without_distance_gives_no_ratio(real: DescribedSet, unit: float | None):
    assert rows_of(compare(real, [described("ours", 40, 1.0, 1)]), unit)[0]["R"] == ""


@pytest.mark.slow
def test_a_failed_comparison_leaves_no_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    real, few = write_images(tmp_path / "real", 20, 100), write_images(tmp_path / "few", 2, 90)
    with pytest.raises(SystemExit):
        main(["compare-looks", str(few), str(real), "--out", str(tmp_path / "a" / "out")])
    assert "ours has 2 images. Allowed: 3 or more." in capsys.readouterr().err
    assert not list((tmp_path / "a").glob("*out*partial")) and not (tmp_path / "a/out").exists()
