"""`vrcaps organ from-ct`: what it writes, and how mistakes end."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import SimpleITK as sitk
import trimesh

from tests.support import failing, phantom
from vrcaps import cli
from vrcaps.mesh.mesh import Mesh
from vrcaps.organ.read_organ import read_organ
from vrcaps.tools.ct.volume import Volume

pytestmark = pytest.mark.slow

SPACING = (1.5e-3, 1e-3, 1e-3)


@pytest.fixture(scope="module")
def scan() -> Volume:
    judge = trimesh.creation.capsule(0.05, 0.015, count=[30, 30])
    mesh = Mesh(np.array(judge.vertices), np.array(judge.faces))
    return phantom.scan_of(mesh, phantom.Scanner(spacing=SPACING), np.random.default_rng(0))


@pytest.fixture(scope="module")
def files(scan: Volume, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the scan as DICOM, and its gas as a label map (7)."""
    folder = tmp_path_factory.mktemp("ct")
    phantom.write_dicom(folder / "dicom", scan)
    gas = (scan.values < -500).astype(np.uint8)
    gas[:, :8] = gas[:, -8:] = gas[:, :, :8] = gas[:, :, -8:] = 0
    inside = np.zeros_like(gas)
    middle = np.array(gas.shape) // 2
    box = tuple(slice(m - r, m + r) for m, r in zip(middle, (30, 24, 24), strict=True))
    inside[box] = gas[box]
    image = write_nifti(folder / "labels.nii.gz", replace(scan, values=7 * inside))
    image.SetSpacing((2.0, 2.0, 2.0))
    sitk.WriteImage(image, str(folder / "elsewhere.nii.gz"))
    return folder


def write_nifti(path: Path, volume: Volume) -> sitk.Image:
    image = sitk.GetImageFromArray(volume.values)
    direction = volume.T_patient_index[:3, :3] / volume.spacing
    image.SetSpacing((volume.spacing[::-1] * 1e3).tolist())
    image.SetOrigin((volume.T_patient_index[:3, 3] * 1e3).tolist())
    image.SetDirection(direction[:, ::-1].ravel().tolist())
    sitk.WriteImage(image, str(path))
    return image


@pytest.fixture
def without_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    """The overview is not drawn; `test_gas_becomes_a_file_that_records` has one."""
    monkeypatch.setattr("vrcaps.cli.from_ct.report_organ", lambda organ, picture: None)


def run(args: list[str]) -> None:
    cli.main(["organ", "from-ct", *args, "--edge-mm", "3"])


def fail(args: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    return failing.fail(["organ", "from-ct", *args, "--edge-mm", "3"], capsys)


def test_gas_becomes_a_file_that_records(files, tmp_path, capsys) -> None:
    out = tmp_path / "tube.glb"
    run([str(files / "dicom"), "--out", str(out)])
    text = capsys.readouterr().out.replace("\n", "")
    assert f"vrcaps record --organ {out} --out DIR" in text
    assert "lung" in text
    assert (tmp_path / "tube-overview.png").stat().st_size > 10_000
    organ = read_organ(out, unit="m")
    assert organ.centerline.length == pytest.approx(0.08, rel=0.12)
    assert organ.label_names == ("background", "wall")
    record = ["record", "--organ", str(out), "--frames", "2", "--light", "direct"]
    cli.main([*record, "--out", str(tmp_path / "run")])
    cli.main(["check", str(tmp_path / "run")])


def test_all_pieces_are_numbered(files, tmp_path, capsys, without_picture) -> None:
    run([str(files / "dicom"), "--all-pieces", "--out", str(tmp_path / "gas.glb")])
    assert (tmp_path / "gas.glb").exists()  # there is one piece only


def test_labels_become_files_with_their_names(files, tmp_path, capsys, without_picture) -> None:
    args = [str(files / "dicom"), "--labels", str(files / "labels.nii.gz"), "--label", "7"]
    run([*args, "--anatomy", "colon", "--out", str(tmp_path / "a.glb")])
    organ = read_organ(tmp_path / "a.glb", unit="m")
    assert organ.label_names[1] == "caecum"
    assert organ.label_names[-1] == "rectum"
    run([str(files / "labels.nii.gz"), "--label", "7", "--out", str(tmp_path / "b.glb")])
    other = read_organ(tmp_path / "b.glb", unit="m")
    assert np.allclose(organ.vertices.mean(axis=0), other.vertices.mean(axis=0), atol=1e-3)


def test_mistakes_end_in_one_line(files, tmp_path, capsys) -> None:
    dicom, labels = str(files / "dicom"), str(files / "labels.nii.gz")
    out = ["--out", str(tmp_path / "x.glb")]
    assert "ends in .glb" in fail([dicom, "--out", "x.ply"], capsys)
    nowhere = str(tmp_path / "none" / "x.glb")
    assert "does not exist. Create it first" in fail([dicom, "--out", nowhere], capsys)
    assert "No DICOM slice" in fail([str(tmp_path), *out], capsys)
    assert "No scan at" in fail([str(tmp_path / "none"), *out], capsys)
    assert "--labels is given without --label" in fail([dicom, "--labels", labels, *out], capsys)
    assert "apply to gas" in fail([labels, "--label", "7", "--all-pieces", *out], capsys)
    assert "has label 3" in fail([labels, "--label", "3", *out], capsys).replace("(3)", "")
    assert "it is not a label map" in fail([dicom, "--label", "7", *out], capsys)
    elsewhere = [dicom, "--labels", str(files / "elsewhere.nii.gz"), "--label", "7", *out]
    assert "on another grid" in fail(elsewhere, capsys)
    assert "outside the lumen" in fail([dicom, "--seed-mm", "0", "20", "0", *out], capsys)
    assert "Allowed: -1000 to -300" in fail([dicom, "--threshold", "5", *out], capsys)
    assert not list(tmp_path.iterdir())


def test_a_folder_with_two_series_lists_them(scan, tmp_path, capsys) -> None:
    part = scan.crop((slice(0, 4), slice(None), slice(None)))
    for series, first in (("1", 0), ("2", 4)):
        phantom.write_dicom(tmp_path / "mixed", part, series=series, first=first)
    out = ["--out", str(tmp_path / "x.glb")]
    error = fail([str(tmp_path / "mixed"), *out], capsys)
    assert "contains 2 series. Choose one with --series, by index or UID: 1: " in error
    assert "; 2: " in error
    assert "No unique series '3'" in fail([str(tmp_path / "mixed"), "--series", "3", *out], capsys)


def test_a_lumen_that_leaks_ends_in_one_line(scan, tmp_path, capsys) -> None:
    values = scan.values.copy()
    k, j, i = np.array(values.shape) // 2
    values[k - 3 : k + 3, j - 3 : j + 3, :i] = -1000  # from the lumen to the air outside
    write_nifti(tmp_path / "leak.nii.gz", replace(scan, values=values))
    args = [str(tmp_path / "leak.nii.gz"), "--out", str(tmp_path / "x.glb")]
    assert "leaks" in fail(args, capsys)
    assert "leaks to the air outside" in fail([*args, "--seed-mm", "0", "0", "0"], capsys)
    assert not (tmp_path / "x.glb").exists()


@pytest.mark.parametrize(
    ("flags", "text"),
    [
        (["--threshold", "5"], "The gas threshold is 5 HU. Allowed: -1000 to -300."),
        (["--blur", "9"], "The blur is 9 voxels. Allowed: 0 to 5."),
        (["--bridge-mm", "900"], "The bridge width is 900 mm. Allowed: 0 to 200 mm."),
        (["--pass-band", "7"], "The pass band is 7. Allowed: 0.001 to 2."),
        (["--label", "colonn"], "No label named 'colonn'."),
        (["--label", "0"], "Label 0 is background."),
        (["--labels", "none.nii", "--label", "colon"], "No scan at none.nii."),
    ],
)
def test_settings_are_checked_before_the_scan_is_read(
    tmp_path, capsys, monkeypatch, flags, text
) -> None:
    def read(*args, **options):
        pytest.fail("read")

    monkeypatch.setattr("vrcaps.cli.from_ct._read", read)
    out = ["--out", str(tmp_path / "x.glb")]
    assert text in fail([str(tmp_path), *flags, *out], capsys)


def test_a_map_of_fractions_is_no_label_map(tmp_path, capsys) -> None:
    sitk.WriteImage(sitk.GetImageFromArray(np.full((4, 4, 4), 0.7)), str(tmp_path / "a.nii"))
    flags = ["--label", "1", "--out", str(tmp_path / "x.glb")]
    assert "the first is 0.7. Allowed: whole numbers" in fail(
        [str(tmp_path / "a.nii"), *flags], capsys
    )
