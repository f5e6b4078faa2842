"""Grids keep every voxel where it is, however their axes are stored."""

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from vrcaps.core.errors import InputError
from vrcaps.tools.ct.volume import Volume, common_part, upright


def make(shape=(4, 5, 6), seed: int = 0, turn: float = 0.3) -> Volume:
    rng = np.random.default_rng(seed)
    transform = np.eye(4)
    oblique = Rotation.from_rotvec(turn * rng.uniform(-1, 1, 3)).as_matrix()
    transform[:3, :3] = oblique @ np.eye(3)[:, ::-1] * [2e-3, 1e-3, 0.7e-3]
    transform[:3, 3] = rng.uniform(-1, 1, 3)
    return Volume(rng.integers(-1000, 1000, shape).astype(np.int16), transform, "made")


def by_place(volume: Volume) -> dict:
    index = np.argwhere(np.ones(volume.values.shape, bool))
    places = np.round(volume.points(index) * 1e6).astype(int)
    return dict(zip(map(tuple, places.tolist()), volume.values.ravel().tolist(), strict=True))


@pytest.mark.parametrize("order", [*itertools.permutations(range(3))])
@pytest.mark.parametrize("flips", [(1, 1, 1), (-1, 1, -1), (1, -1, 1)])
def test_upright_undoes_any_storage_order(order, flips) -> None:
    volume = make()
    values, transform = volume.values.transpose(order), volume.T_patient_index[:, [*order, 3]]
    transform = transform.copy()
    for axis, flip in enumerate(flips):
        if flip < 0:
            values = np.flip(values, axis)
            transform[:3, 3] += transform[:3, axis] * (values.shape[axis] - 1)
            transform[:3, axis] *= -1
    again = upright(Volume(values, transform, "stored"))
    assert np.array_equal(again.values, volume.values)
    assert np.allclose(again.T_patient_index, volume.T_patient_index)


def test_index_and_points_are_inverse_and_crop_moves_nothing() -> None:
    volume = make()
    index = np.random.default_rng(1).uniform(-2, 9, (20, 3))
    assert np.allclose(volume.index(volume.points(index)), index)
    part = volume.crop((slice(1, 3), slice(2, 5), slice(0, 4)))
    whole = by_place(volume)
    assert by_place(part).items() <= whole.items()
    assert volume.voxel_volume == pytest.approx(1.4e-9)


def test_labels_of_a_part_of_the_grid_are_matched_by_place() -> None:
    scan = make((8, 9, 10))
    labels = scan.crop((slice(2, 7), slice(0, 5), slice(3, 10)))
    both = common_part(scan, labels)
    assert np.array_equal(both[0].values, both[1].values)
    assert np.allclose(both[0].T_patient_index, both[1].T_patient_index)


def test_labels_on_another_grid_are_refused() -> None:
    scan = make()
    shifted = scan.T_patient_index.copy()
    shifted[:3, 3] += 0.4 * shifted[:3, 0]
    with pytest.raises(InputError, match="is on another grid than the scan"):
        common_part(scan, Volume(scan.values, shifted, "labels"))
    scaled = scan.T_patient_index.copy()
    scaled[:3, :3] *= 1.2
    with pytest.raises(InputError, match="is on another grid than the scan"):
        common_part(scan, Volume(scan.values, scaled, "labels"))


def test_labels_elsewhere_are_refused() -> None:
    scan = make()
    far = scan.T_patient_index.copy()
    far[:3, 3] += 100 * far[:3, 0]
    with pytest.raises(InputError, match="do not overlap"):
        common_part(scan, Volume(scan.values, far, "labels"))
