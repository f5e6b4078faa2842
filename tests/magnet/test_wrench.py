"""Forces and torques: conservation laws, published numbers, virtual work."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.support.scenes import random_directions, random_poses
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import transform_from, transform_points
from vrcaps.magnet.field import field, wrench
from vrcaps.magnet.sources import (
    MAGNETIC_CONSTANT,
    Coil,
    Cylinder,
    Dipole,
    InternalMagnet,
    UniformField,
    magnet_pose,
)

SMALL = InternalMagnet((0, 0, 0), (0, 0, 1.12))


@pytest.mark.parametrize(
    ("distance", "force", "torque"), [(0.10, 6.52, 0.217), (0.15, 1.29, 0.064), (0.20, 0.41, 0.027)]
)
def test_published_pair(distance, force, torque):
    """970.1 and 1.12 A·m², coaxial; torque at right angles. F = 3 μ₀ m₁ m₂/(2π r⁴)."""
    pose = transform_from(np.eye(3), np.array([0, 0, distance]))
    pulled, turned = wrench([Dipole(970.1)], [SMALL], pose)
    assert abs(-pulled[2] / force - 1) < 0.01
    exact = 3 * MAGNETIC_CONSTANT * 970.1 * 1.12 / (2 * np.pi * distance**4)
    np.testing.assert_allclose(pulled, [0, 0, -exact], rtol=1e-12, atol=1e-15)
    assert np.abs(turned).max() < 1e-15
    across = InternalMagnet((0, 0, 0), (1.12, 0, 0))
    largest = np.linalg.norm(wrench([Dipole(970.1)], [across], pose)[1])
    assert abs(largest / torque - 1) < 0.01


def test_newtons_third_law_between_dipoles():
    """Forces are opposite, and so are the torques about any one point."""
    rng = np.random.default_rng(0)
    for _ in range(200):
        places = rng.uniform(-0.2, 0.2, (2, 3))
        axes, sizes = random_directions(rng, 2), rng.uniform(0.1, 10, 2)
        parts = []
        for one, other in ((0, 1), (1, 0)):
            source = Dipole(sizes[one], magnet_pose(places[one], axes[one]))
            magnet = InternalMagnet((0, 0, 0), tuple(sizes[other] * axes[other]))
            pose = transform_from(np.eye(3), places[other])
            force, torque = wrench([source], [magnet], pose)
            parts.append((force, torque + np.cross(places[other], force)))
        (f1, n1), (f2, n2) = parts
        assert np.linalg.norm(f1 + f2) < 1e-9 * np.linalg.norm(f1)
        scale = np.linalg.norm(n1) + np.linalg.norm(f1) * np.linalg.norm(places)
        assert np.linalg.norm(n1 + n2) < 1e-9 * scale


def test_wrench_is_the_slope_of_the_energy():
    """F = −∂U/∂x and N = −∂U/∂θ with U = −Σ m·B, for magnets anywhere in the body."""
    rng = np.random.default_rng(1)
    sources = [Cylinder(0.1, 0.1, 1.4), Coil(0.08, 20.0, 50, magnet_pose((0.2, 0, 0), (1, 1, 0)))]
    magnets = [
        InternalMagnet(tuple(rng.uniform(-0.01, 0.01, 3)), tuple(rng.normal(size=3)))
        for _ in range(3)
    ]
    pose = random_poses(rng, 1, 0.05)[0]
    pose[:3, 3] += [0.1, 0.15, 0.2]

    def energy(pose: np.ndarray) -> float:
        places = np.array([m.position_capsule for m in magnets])
        moments = np.array([m.moment_capsule for m in magnets]) @ pose[:3, :3].T
        return -float(np.sum(moments * field(sources, transform_points(pose, places))[0]))

    def moved(step: np.ndarray) -> np.ndarray:
        turn = Rotation.from_rotvec(step[3:]).as_matrix()
        return transform_from(turn @ pose[:3, :3], pose[:3, 3] + step[:3])

    h = 1e-5
    slope = [(energy(moved(-h * e)) - energy(moved(h * e))) / (2 * h) for e in np.eye(6)]
    force, torque = wrench(sources, magnets, pose)
    np.testing.assert_allclose(np.concatenate([force, torque]), slope, rtol=1e-6, atol=1e-9)


def test_uniform_field_turns_and_does_not_pull():
    pose = random_poses(np.random.default_rng(2), 1)[0]
    off_center = InternalMagnet((0.004, 0, -0.003), (0.1, 0.2, 0.3))
    force, torque = wrench([UniformField(0.05)], [off_center], pose)
    assert not force.any()
    moment = pose[:3, :3] @ [0.1, 0.2, 0.3]
    np.testing.assert_allclose(torque, np.cross(moment, [0, 0, 0.05]), rtol=1e-12)


def test_off_center_magnet_also_turns_the_capsule():
    """N = m × B + arm × F: coaxial, but 5 mm beside the capsule's origin."""
    pose = transform_from(np.eye(3), np.array([-0.005, 0, 0.1]))
    beside = InternalMagnet((0.005, 0, 0), (0, 0, 1.12))
    force, torque = wrench([Dipole(970.1)], [beside], pose)
    np.testing.assert_allclose(torque, np.cross([0.005, 0, 0], force), rtol=1e-12)
    assert abs(torque[1]) > 0.03


def test_many_poses_at_once():
    rng = np.random.default_rng(3)
    poses = random_poses(rng, 6).reshape(2, 3, 4, 4)
    force, torque = wrench([Cylinder(0.1, 0.1, 1.4)], [SMALL], poses)
    assert force.shape == torque.shape == (2, 3, 3)
    one = wrench([Cylinder(0.1, 0.1, 1.4)], [SMALL], poses[1, 2])
    assert np.array_equal(force[1, 2], one[0])
    assert np.array_equal(torque[1, 2], one[1])


def test_no_magnets_feel_nothing():
    force, torque = wrench([Dipole(970.0)], [], np.eye(4))
    assert not force.any()
    assert not torque.any()


def test_capsule_in_a_dipole():
    with pytest.raises(InputError, match=r"Point 0 .* is in a dipole"):
        wrench([Dipole(1.0)], [SMALL], np.eye(4))


def test_poses_must_be_finite_matrices():
    with pytest.raises(InputError, match=r"Poses have shape \(4, 4\)\. Allowed: finite"):
        wrench([Dipole(1.0)], [SMALL], np.full((4, 4), np.nan))


@pytest.mark.parametrize("moment", [(0, 0, 0), (0, np.inf, 1)])
def test_internal_magnet_needs_a_moment(moment):
    with pytest.raises(
        InputError, match=r"Allowed: three finite numbers each, the moment not zero"
    ):
        InternalMagnet((0, 0, 0), moment)
