"""Real scans, where the optional test data is at hand."""

import tarfile
from pathlib import Path

import numpy as np
import pytest

from vrcaps.organ.measure import measure_organ
from vrcaps.tools.ct.from_ct import (
    TOTALSEGMENTATOR,
    WallOptions,
    find_lumens,
    organ_from_gas,
    organ_from_label,
)
from vrcaps.tools.ct.scan_files import read_volume
from vrcaps.tools.ct.volume import Volume, common_part

ML = 1e-6


@pytest.mark.validation
def test_visible_human_pelvis(shared_data: Path, tmp_path: Path) -> None:
    """Every gas-filled piece of bowel, in the bones' midst, but neither bone nor outside air."""
    with tarfile.open(shared_data / "ct" / "vhm_pelvis_140_dicom.tar.gz") as archive:
        archive.extractall(tmp_path, filter="data")
    scan = read_volume(tmp_path)
    assert scan.values.shape == (140, 512, 512)
    assert scan.values.min() == -1024
    gas = find_lumens(scan)
    assert len(gas.gut) == 7
    assert sum(piece.volume for piece in gas.gut) == pytest.approx(244 * ML, rel=0.05)
    assert all(0.12 < piece.center[1] < 0.28 for piece in gas.gut)
    sigmoid = organ_from_gas(scan, gas, gas.gut[1], wall=WallOptions(edge=2.5e-3), name="sigmoid")
    assert measure_organ(sigmoid).volume == pytest.approx(67 * ML, rel=0.1)
    values = scan.values[tuple(np.rint(scan.index(sigmoid.vertices)).astype(int).T)]
    assert -700 < np.median(values) < -300  # half-way between gas and wall


@pytest.mark.validation
def test_colon_mask_keeps_its_volume(shared_data: Path) -> None:
    mask = read_volume(shared_data / "ct" / "colon_A_512x512x460.nii.gz")
    wall = WallOptions(edge=5e-3, anatomy="colon", bridge=0.04)
    colon = organ_from_label(mask, 1, wall=wall, name="colon")
    facts = measure_organ(colon)
    assert facts.volume == pytest.approx(2104 * ML, rel=0.02)
    assert facts.length > 1.2
    assert colon.centerline.points[0, 0] < colon.centerline.points[:, 0].mean()  # caecum: right
    assert colon.centerline.points[-1, 2] < colon.centerline.points[:, 2].min() + 0.02
    assert set(np.unique(colon.label)) == set(range(1, 9))


@pytest.fixture(scope="module")
def overlap(shared_data: Path) -> tuple[Volume, Volume]:
    """A scan and its label map where they overlap."""
    scan = read_volume(shared_data / "ct" / "example_ct.nii.gz")
    return common_part(scan, read_volume(shared_data / "ct" / "example_seg.nii.gz"))


@pytest.mark.slow
@pytest.mark.parametrize(
    "label",
    [
        pytest.param("colon", marks=pytest.mark.validation),
        "stomach",
        "duodenum",
        pytest.param("small_bowel", marks=pytest.mark.validation),
    ],
)
def test_labels_where_they_overlap_the_scan(overlap: tuple[Volume, Volume], label: str) -> None:
    part, labels = overlap
    assert part.values.shape == labels.values.shape == (30, 101, 122)
    number = TOTALSEGMENTATOR[label]
    organ = organ_from_label(
        labels, number, wall=WallOptions(edge=3e-3), name=label, label_name=label
    )
    volume = np.count_nonzero(labels.values == number) * labels.voxel_volume
    assert 0.5 * volume < measure_organ(organ).volume < 1.1 * volume
