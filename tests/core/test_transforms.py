"""Transforms: group axioms, round trips, and SciPy as an independent oracle."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from vrcaps.core.errors import InputError
from vrcaps.core.geometry import (
    invert,
    look_along,
    matrix_from_quaternion,
    matrix_from_unit_quaternion,
    quaternion_from_matrix,
    require_rigid,
    rotate_vectors,
    transform_from,
    transform_points,
)

BATCHES = [(), (7,), (2, 3)]


def random_rotations(rng: np.random.Generator, batch: tuple[int, ...]) -> np.ndarray:
    rotations = Rotation.random(int(np.prod(batch)), rng=rng).as_matrix()
    return rotations.reshape(*batch, 3, 3)


def random_transforms(rng: np.random.Generator, batch: tuple[int, ...]) -> np.ndarray:
    return transform_from(random_rotations(rng, batch), rng.normal(size=(*batch, 3)))


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)


@pytest.mark.parametrize("batch", BATCHES)
def test_inverse_undoes(rng: np.random.Generator, batch: tuple[int, ...]) -> None:
    T_a_b = random_transforms(rng, batch)
    identity = np.broadcast_to(np.eye(4), T_a_b.shape)
    np.testing.assert_allclose(T_a_b @ invert(T_a_b), identity, atol=1e-14)
    np.testing.assert_allclose(invert(T_a_b), np.linalg.inv(T_a_b), atol=1e-13)


@pytest.mark.parametrize("batch", BATCHES)
def test_composition_is_successive_mapping(
    rng: np.random.Generator, batch: tuple[int, ...]
) -> None:
    T_a_b, T_b_c = random_transforms(rng, batch), random_transforms(rng, batch)
    points_c = rng.normal(size=(*batch, 5, 3))
    points_a = transform_points(T_a_b, transform_points(T_b_c, points_c))
    np.testing.assert_allclose(points_a, transform_points(T_a_b @ T_b_c, points_c), atol=1e-13)


@pytest.mark.parametrize("batch", BATCHES)
def test_points_move_with_the_homogeneous_matrix_and_vectors_do_not_translate(
    rng: np.random.Generator, batch: tuple[int, ...]
) -> None:
    T_a_b = random_transforms(rng, batch)
    points_b = rng.normal(size=(*batch, 5, 3))
    homogeneous = np.concatenate([points_b, np.ones((*batch, 5, 1))], axis=-1)
    expected = np.einsum("...ij,...nj->...ni", T_a_b, homogeneous)[..., :3]
    np.testing.assert_allclose(transform_points(T_a_b, points_b), expected, atol=1e-14)
    difference = rotate_vectors(T_a_b, points_b) - (expected - T_a_b[..., None, :3, 3])
    np.testing.assert_allclose(difference, 0.0, atol=1e-14)


def test_translation_broadcasts_over_rotations(rng: np.random.Generator) -> None:
    transforms = transform_from(random_rotations(rng, (4,)), np.array([1.0, 2.0, 3.0]))
    assert transforms.shape == (4, 4, 4)
    np.testing.assert_array_equal(transforms[:, :3, 3], np.tile([1.0, 2.0, 3.0], (4, 1)))


@pytest.mark.parametrize("batch", BATCHES)
def test_quaternion_agrees_with_scipy(rng: np.random.Generator, batch: tuple[int, ...]) -> None:
    rotation = random_rotations(rng, batch)
    expected = Rotation.from_matrix(rotation).as_quat(canonical=True, scalar_first=True)
    wxyz = quaternion_from_matrix(rotation)
    np.testing.assert_allclose(wxyz, expected, atol=1e-14)
    np.testing.assert_allclose(matrix_from_quaternion(wxyz), rotation, atol=1e-14)


@pytest.mark.parametrize("axis", np.vstack([np.eye(3), [[1.0, 1.0, 0.0], [0.1, 1e-8, 1.0]]]))
@pytest.mark.parametrize("angle", [0.0, 1e-9, np.pi - 1e-9, np.pi])
def test_quaternion_is_exact_near_no_turn_and_half_turns(axis: np.ndarray, angle: float) -> None:
    rotation = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix()
    wxyz = quaternion_from_matrix(rotation)
    assert wxyz[0] >= 0.0
    np.testing.assert_allclose(np.linalg.norm(wxyz), 1.0, rtol=1e-15)
    np.testing.assert_allclose(matrix_from_quaternion(wxyz), rotation, atol=1e-14)


def test_quaternion_length_does_not_matter(rng: np.random.Generator) -> None:
    wxyz = rng.normal(size=(20, 4))
    scaled = wxyz * rng.uniform(1e-3, 1e3, size=(20, 1))
    np.testing.assert_allclose(
        matrix_from_quaternion(scaled), matrix_from_quaternion(wxyz), atol=1e-14
    )


@pytest.mark.parametrize("wxyz", [[0.0] * 4, [np.nan, 0.0, 0.0, 1.0], [np.inf, 0.0, 0.0, 1.0]])
def test_quaternion_must_be_finite_and_not_zero(wxyz: list[float]) -> None:
    with pytest.raises(InputError, match="quaternion is zero or not finite"):
        matrix_from_quaternion(np.array([[1.0, 0.0, 0.0, 0.0], wxyz]))


def test_look_along_is_a_camera(rng: np.random.Generator) -> None:
    """Columns are right, down, forward: forward as given, up in the image is up in the world."""
    forward, up = rng.normal(size=(50, 3)), np.array([0.0, 0.0, 1.0])
    rotation = look_along(forward, up)
    np.testing.assert_allclose(np.linalg.det(rotation), 1.0, rtol=1e-12)
    np.testing.assert_allclose(
        rotation[..., 2], forward / np.linalg.norm(forward, axis=-1, keepdims=True), atol=1e-14
    )
    np.testing.assert_allclose(rotation[..., 0] @ up, 0.0, atol=1e-14)
    assert np.all(rotation[..., 1] @ up < 0.0)


@pytest.mark.parametrize("forward", [[0.0, 0.0, 0.0], [0.0, 0.0, 2.0], [0.0, 0.0, -1.0]])
def test_look_along_needs_a_direction_not_parallel_to_up(forward: list[float]) -> None:
    with pytest.raises(InputError, match="zero or parallel to up"):
        look_along(np.array(forward), np.array([0.0, 0.0, 1.0]))


def test_quaternions_of_files_have_unit_length():
    """2 % too long is another's number; rounding to two digits is allowed."""
    half = np.sqrt(0.5)
    turn = matrix_from_unit_quaternion(np.array([[half, 0, 0, half]]).round(2), "a.txt")[0]
    np.testing.assert_allclose(turn @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=0.01)
    for wrong in (1.02, 0.5, 0.0, np.nan, np.inf):
        with pytest.raises(
            InputError, match=r"a\.txt contains a quaternion of length .* \(pose 1\)"
        ):
            matrix_from_unit_quaternion(np.array([[1.0, 0, 0, 0], [wrong, 0, 0, 0]]), "a.txt")


def test_a_matrix_of_another_shape_is_no_transform():
    with pytest.raises(InputError, match="is not a rigid transform: its shape is"):
        require_rigid(np.eye(3), "T")
