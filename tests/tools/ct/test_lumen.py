"""Selection of the gas in the gut, and errors if there is none."""

import numpy as np
import pytest

from tests.support.phantom import GAS, LUNG, WALL, coverage
from vrcaps.core.errors import InputError
from vrcaps.tools.ct.from_ct import find_lumens
from vrcaps.tools.ct.lumen import body_mask, choose_gas, find_gas
from vrcaps.tools.ct.volume import Volume

SPACING = 2e-3


def boxes(*extra: tuple[slice, slice, slice, float], noise: float = 0.0) -> Volume:
    """A body in air, 2 mm voxels, with boxes of other values in it."""
    values = np.full((60, 80, 80), GAS, np.float32)
    values[:, 12:68, 12:68] = WALL
    for *box, value in extra:
        values[tuple(box)] = value
    values += noise * np.random.default_rng(0).standard_normal(values.shape)
    transform = np.eye(4)
    transform[:3, :3] = SPACING * np.eye(3)[:, ::-1]
    transform[:3, 3] = 0.1, 0.2, 0.3
    return Volume(values.astype(np.int16), transform, "boxes")


BOWEL = (slice(20, 40), slice(30, 45), slice(30, 42), GAS)
SMALL = (slice(5, 15), slice(30, 40), slice(50, 60), GAS)
LUNGS = (slice(45, 60), slice(20, 60), slice(20, 60), LUNG)
TABLE = (slice(0, 60), slice(72, 74), slice(5, 75), -100.0)
PAD = (slice(5, 55), slice(69, 72), slice(20, 60), -990.0)
SHELL = (slice(4, 56), slice(68, 73), slice(18, 62), -100.0)


def place(box) -> np.ndarray:
    index = np.array([(part.start + part.stop - 1) / 2 for part in box[:3]])
    return boxes().points(index[None])[0]


def test_bowel_is_found_and_lungs_table_and_outside_are_not() -> None:
    scan = boxes(BOWEL, SMALL, LUNGS, SHELL, PAD, noise=20.0)
    gas = find_gas(scan)
    kinds = [piece.kind for piece in gas.pieces]
    assert sorted(kinds) == ["gut", "gut", "lung", "outside"]
    large, small = gas.gut
    assert large.volume == pytest.approx(20 * 15 * 12 * SPACING**3, rel=0.01)
    assert small.volume == pytest.approx(10**3 * SPACING**3, rel=0.01)
    assert np.allclose(large.center, place(BOWEL), atol=2 * SPACING)
    assert gas.hounsfield == pytest.approx(GAS, abs=3)
    assert [p.label for p in choose_gas(gas, scan)] == [large.label, small.label]


def test_a_seed_chooses_the_gas_it_lies_in() -> None:
    scan = boxes(BOWEL, SMALL)
    gas = find_gas(scan)
    assert choose_gas(gas, scan, seed=place(SMALL)) == (gas.gut[1],)


def test_the_body_is_full_and_the_table_not_in_it() -> None:
    mask, (k, j, i) = body_mask(boxes(BOWEL, TABLE))
    assert (k, j, i) == (2, 2, 2)
    assert mask[:, 7:33, 7:33].all()
    assert not mask[:, 35:].any()


def test_no_lumen() -> None:
    scan = boxes()
    with pytest.raises(InputError, match="No lumen in boxes: no gas of 1 ml or more"):
        choose_gas(find_gas(scan), scan)


def test_a_seed_outside_the_scan_or_the_lumen() -> None:
    scan = boxes(BOWEL)
    gas = find_gas(scan)
    with pytest.raises(InputError, match="lies outside the scan, which goes from"):
        choose_gas(gas, scan, seed=np.array([0.0, 0.0, 5.0]))
    with pytest.raises(InputError, match=r"is outside the lumen \(40 HU there\). Gas lies at: \("):
        choose_gas(gas, scan, seed=place(SMALL))


def test_a_lumen_that_leaks() -> None:
    channel = (slice(28, 31), slice(35, 38), slice(0, 32), GAS)
    scan = boxes(BOWEL, channel)
    gas = find_gas(scan)
    with pytest.raises(InputError, match=r"The lumen leaks: \d+ ml of gas around"):
        choose_gas(gas, scan)
    with pytest.raises(InputError, match="leaks to the air outside"):
        choose_gas(gas, scan, seed=place(BOWEL))


def test_a_threshold_that_is_none() -> None:
    with pytest.raises(InputError, match=r"The gas threshold is 40 HU. Allowed: -1000 to -300"):
        find_lumens(boxes(BOWEL), threshold=40)


@pytest.mark.slow
def test_the_phantom_has_the_volume_of_its_organ(tube, dry_scan) -> None:
    """The oracle itself: Σ coverage × voxel = the divergence theorem's volume."""
    mesh, _ = tube
    share = coverage(mesh, dry_scan.T_patient_index, dry_scan.values.shape)
    a, b, c = (mesh.vertices[mesh.faces] - mesh.vertices.mean(axis=0)).transpose(1, 0, 2)
    volume = abs(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)
    assert share.sum() * dry_scan.voxel_volume == pytest.approx(volume, rel=1e-3)
