"""The map that a capsule builds itself, and the observation of its unknown space."""

from __future__ import annotations

import numpy as np
import pytest
from gymnasium.spaces import Dict

from tests.support.small_envs import GUT, simulation_of, small_settings
from vrcaps.capsule.device_file import read_device
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import unit
from vrcaps.env.exploration import (
    HEADINGS,
    VOXEL,
    ExplorationObservation,
    VoxelMap,
    floor_paths,
    image_rays,
)
from vrcaps.env.observations import ImageObservation, StateObservation
from vrcaps.env.vector_env import CapsuleVectorEnv

RADIUS = 0.04
RAYS = unit(np.random.default_rng(0).normal(size=(8000, 3)))


def ball(rays: np.ndarray) -> VoxelMap:
    """Map of a hollow ball of 4 cm, seen from its center along some rays."""
    known = VoxelMap()
    for _ in range(3):
        known.add(np.zeros(3), rays, np.full(len(rays), RADIUS))
    return known


def evidence(known: VoxelMap, points: np.ndarray) -> np.ndarray:
    return known.evidence[tuple(known.index(points).T)]


def test_rays_free_the_space_before_the_wall_and_leave_that_behind_it_unknown() -> None:
    known = ball(RAYS)
    assert (evidence(known, 0.6 * RADIUS * RAYS) < 0).all()
    assert (evidence(known, (RADIUS + 0.2 * VOXEL) * RAYS) > 0).all()
    assert (evidence(known, (RADIUS + 2.0 * VOXEL) * RAYS) == 0).all()
    np.testing.assert_allclose(known.index(known.center(np.array([3, 40, 63]))), [3, 40, 63])


def test_a_pixel_without_wall_adds_nothing() -> None:
    known = VoxelMap()
    known.add(np.zeros(3), RAYS, np.zeros(len(RAYS)))
    assert not known.evidence.any()


def test_views_towards_what_no_ray_has_seen_gain_most() -> None:
    """The upper half is seen; a view down would show the lower half of a sphere of a voxel."""
    up = HEADINGS[:, 2] > 0.9
    half = ball(RAYS[RAYS[:, 2] > 0.0])
    gains = half.gains(np.array([[0.0, 0.0, 0.01]]))[0]
    assert gains[HEADINGS[:, 2] < -0.9].min() > 3.0 * gains[up].max()
    assert ball(RAYS).gains(np.zeros((1, 3))).max() < 0.3 * gains.max()  # between corners


def test_a_completed_view_is_expected_to_show_less() -> None:
    half = ball(RAYS[RAYS[:, 2] > 0.0])
    here, down = np.array([0.0, 0.0, 0.01]), HEADINGS[:, 2] < -0.9
    before = half.gains(here[None])[0, down].item()
    half.complete(here, np.array([0.0, 0.0, -1.0]))
    after = half.gains(here[None])[0, down].item()
    assert after == pytest.approx(before / 4.0, rel=0.01)


def test_paths_lead_over_the_floor_around_a_gap_and_not_to_another_room() -> None:
    """A floor of 9 by 9 voxels with a slit to its middle; a room apart from it."""
    known = VoxelMap()
    known.evidence[28:37, 28:37, 20:30] = -3
    known.evidence[32, 30:37] = 0  # open at y = 28 and 29 only
    known.evidence[50:52, 50:52, 20:30] = -3
    start, end = known.center(np.array([[29, 36, 20], [36, 36, 20]]))
    points, lengths, path_to = floor_paths(known, start)
    assert len(points) == 9 * 9 - 7
    np.testing.assert_allclose(points[:, 2], start[2])
    path = path_to(end)
    np.testing.assert_allclose(path[[0, -1]], [start, end])
    length = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
    assert length == pytest.approx(lengths[np.abs(points - end).sum(axis=1).argmin()])
    assert length > 2.0 * np.linalg.norm(end - start)


def test_an_empty_map_has_no_paths() -> None:
    points, lengths, path_to = floor_paths(VoxelMap(), np.zeros(3))
    assert len(points) == len(lengths) == 0
    np.testing.assert_array_equal(path_to(np.ones(3)), np.zeros((1, 3)))


def test_rays_are_those_of_the_image() -> None:
    rays = image_rays(read_device("magnetic"), (24, 24))
    is_ray = np.isfinite(rays).all(axis=1)
    assert 0.5 < is_ray.mean() < 1.0
    np.testing.assert_allclose(np.linalg.norm(rays[is_ray], axis=1), 1.0, atol=1e-6)
    assert rays[is_ray, 2].mean() > 0.4


def observed(**keywords) -> tuple[CapsuleVectorEnv, np.ndarray]:
    observations = (StateObservation(pose="located"), ExplorationObservation(**keywords))
    settings = small_settings(observations=observations, actuation="magnet", control_period=0.05)
    envs = CapsuleVectorEnv(settings, 2, autoreset_mode="Disabled")
    rows, _ = envs.reset(seed=3)
    return envs, rows["exploration"]


def test_features_are_named_bounded_and_those_of_the_own_map() -> None:
    envs, first = observed()
    names, space = envs.observation_names["exploration"], envs.single_observation_space
    assert isinstance(space, Dict)
    assert len(names) == first.shape[1]
    assert space["exploration"].contains(first[0])
    by_name = dict(zip(names, first[0], strict=True))
    ahead = [k for k, h in enumerate(HEADINGS) if h @ envs.view.T_world_capsule[0, :3, 2] > 0.9]
    behind = [k for k, h in enumerate(HEADINGS) if h @ envs.view.T_world_capsule[0, :3, 2] < -0.9]
    assert by_name[f"free_{ahead[0]} [20 mm]"] > 2.0 * by_name[f"free_{behind[0]} [20 mm]"]
    again = envs.episode.observe()["exploration"]
    np.testing.assert_array_equal(again, first)  # an image is added once
    moved = envs.step(np.zeros((2, 6), np.float32))[0]["exploration"]
    assert np.abs(moved - first).max() > 1e-4


def test_a_snapshot_holds_the_map() -> None:
    envs, _ = observed()
    snapshot = envs.snapshot()
    action = np.full((2, 6), 0.3, np.float32)
    after = envs.step(action)[0]["exploration"]
    envs.restore(snapshot)
    np.testing.assert_array_equal(envs.step(action)[0]["exploration"], after)


def test_it_locates_the_capsule_without_the_state() -> None:
    settings = {"actuation": "magnet", "organs": (GUT,)}
    alone = simulation_of(1, observations=(ExplorationObservation(),), **settings)
    (observation,) = alone.settings.observations
    assert observation.observe(alone.view).shape == (1, 68)
    with pytest.raises(InputError, match="by one magnet in the capsule; mirocam has 0"):
        simulation_of(1, observations=(ExplorationObservation(),), capsule="mirocam")


def test_noise_has_the_stated_size_and_is_the_same_when_read_again() -> None:
    exact = ImageObservation("ray_distance", size=(24, 24), key="exact")
    noisy = ImageObservation("ray_distance", size=(24, 24), key="noisy", noise=0.1)
    simulation = simulation_of(1, observations=(exact, noisy))
    true, given = (o.observe(simulation.view)[0] for o in (exact, noisy))
    seen = true > 0.0
    factors = np.log(given[seen] / true[seen])
    assert factors.std() == pytest.approx(0.1, rel=0.1)
    assert abs(factors.mean()) < 0.3
    np.testing.assert_array_equal(noisy.observe(simulation.view)[0], given)
    with pytest.raises(InputError, match=r"noise is 0\.1 of rgb"):
        ImageObservation("rgb", noise=0.1)
