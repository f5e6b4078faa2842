import numpy as np
import pytest

from vrcaps.core.errors import InputError
from vrcaps.core.geometry import (
    look_along,
    matrix_from_quaternion,
    rotation_from_vector,
    rotation_vector,
    transform_from,
)
from vrcaps.motion.trajectory import (
    resample,
    trajectory_from_poses,
)


def _helix(times, rate=2.0, pitch=0.01):
    """A body on a helix of radius 5 cm, turning about z with the angular velocity `rate`."""
    angle = rate * times
    zero = np.zeros_like(angle)
    wxyz = np.stack([np.cos(angle / 2), zero, zero, np.sin(angle / 2)], -1)
    positions = np.stack([0.05 * np.cos(angle), 0.05 * np.sin(angle), pitch * times], -1)
    return transform_from(matrix_from_quaternion(wxyz), positions)


def test_rotation_vector_inverts_rotation_from_vector(rng):
    """log(exp(v)) = v for angles below π; exp(log(R)) = R always."""
    vectors = rng.normal(size=(200, 3))
    vectors *= (rng.uniform(0.0, np.pi - 1e-3, 200) / np.linalg.norm(vectors, axis=1))[:, None]
    vectors[0] = 0.0
    vectors[1] = [1e-9, 0.0, 0.0]
    R_a = matrix_from_quaternion(rng.normal(size=(200, 4)))
    R_b = rotation_from_vector(vectors) @ R_a
    np.testing.assert_allclose(rotation_vector(R_a, R_b), vectors, atol=1e-9)


def test_velocities_of_a_helix():
    """v = ω × r + pitch e_z; central differences err by (ω dt)²/6."""
    times = np.linspace(0.0, 3.0, 301)
    trajectory = trajectory_from_poses(times, _helix(times))
    inner = slice(1, -1)
    omega = np.array([0.0, 0.0, 2.0])
    expected = np.cross(omega, trajectory.Ts_world_capsule[:, :3, 3]) + np.array([0, 0, 0.01])
    tolerance = 0.1 * (2.0 * 0.01) ** 2 / 6
    np.testing.assert_allclose(
        trajectory.linear_velocities_world[inner], expected[inner], atol=tolerance
    )
    np.testing.assert_allclose(
        trajectory.angular_velocities_world, np.tile(omega, (301, 1)), atol=1e-9
    )


def test_resample_is_exact_for_constant_rates():
    """Linear motion with a constant turn is reproduced at any time."""
    coarse = np.array([0.0, 0.3, 0.35, 1.0])

    def poses(times):
        zero = np.zeros_like(times)
        wxyz = np.stack([np.cos(times), zero, np.sin(times), zero], -1)
        return transform_from(matrix_from_quaternion(wxyz), times[:, None] * [0.1, 0.2, -0.3])

    fine = np.linspace(0.0, 1.0, 57)
    resampled = resample(trajectory_from_poses(coarse, poses(coarse)), fine)
    np.testing.assert_allclose(resampled.Ts_world_capsule, poses(fine), atol=1e-12)
    single = resample(trajectory_from_poses(coarse, poses(coarse)), np.array([0.5]))
    np.testing.assert_allclose(single.linear_velocities_world, [[0.1, 0.2, -0.3]], atol=1e-12)
    np.testing.assert_allclose(single.angular_velocities_world, [[0.0, 2.0, 0.0]], atol=1e-9)


@pytest.mark.parametrize("times", [[-0.1, 0.5], [0.5, 1.2]])
def test_resample_outside_the_recording(times):
    own = np.array([0.0, 1.0])
    trajectory = trajectory_from_poses(own, _helix(own))
    with pytest.raises(InputError, match=r"covers 0 s to 1 s, but the frames need"):
        resample(trajectory, np.array(times))


def test_require_inside_names_camera_frame_and_distance(model):
    """Clearance on the axis of the tube is its radius; one step sideways leaves it."""
    line = model.organ.centerline
    points = line.points @ model.T_world_patient[:3, :3].T
    rotation = look_along(np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]))
    inside, outside = points[60], points[60] + [0.0, 0.0, 0.05]
    Ts = transform_from(rotation, np.array([inside, inside, outside, outside]))
    good = trajectory_from_poses(np.arange(2.0), Ts[:2])
    model.require_inside(good.Ts_world_capsule)
    bad = trajectory_from_poses(np.arange(4.0), Ts)
    with pytest.raises(InputError, match=r"mm outside the lumen of 'tube' at frame 2 \(2 of 4"):
        model.require_inside(bad.Ts_world_capsule)
    state = bad.state(2)
    assert state.time == 2.0
    np.testing.assert_array_equal(state.T_world_capsule, Ts[2])
