"""Landmarks in a straight tube, where each is known in closed form."""

import numpy as np
import pytest

from tests.support.small_envs import GUT, SHORT_GUT, simulation_of
from vrcaps import _core
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import transform_from, wall_of
from vrcaps.env.landmarks import RAYS, LandmarksObservation
from vrcaps.env.randomization import Start
from vrcaps.env.tasks import NavigateTask

_SCALE = 0.02


def _told(view, **options):
    return LandmarksObservation(**options).observe(view)


def _distance(told):
    """A distance [m] from d / (d + 20 mm)."""
    return _SCALE * told / (1.0 - told)


def test_distances_to_a_tubes_wall_are_its_radius_and_where_its_ends_are():
    simulation = simulation_of()
    told = _told(simulation.view)[0].astype(float)
    pose = simulation.worlds.T_world_capsule[0]
    place, axes = pose[:3, 3], pose[:3, :3]
    rays = _distance(told[27:41])
    assert rays[:2] == pytest.approx(0.02, rel=0.03)  # a polygon of 31 corners
    assert rays[2] == pytest.approx(0.09, rel=1e-3)
    assert rays[5] == pytest.approx(0.09, rel=1e-3)
    oblique = np.abs(RAYS[6:] @ axes.T @ axes[:, 2])
    assert rays[6:] == pytest.approx(0.02 / np.sqrt(1.0 - oblique**2), rel=0.03)
    assert abs(place[1]) < 1e-9


def test_guides_in_the_capsules_frame_do_not_depend_on_how_it_lies_in_the_world():
    one = _told(simulation_of(posture="supine").view)[0]
    other = _told(simulation_of(posture="left-lateral").view)[0]
    is_gravity = np.zeros(len(one), bool)
    is_gravity[15:18] = True
    # What hangs on gravity: its direction alone, before the first step.
    np.testing.assert_allclose(one[~is_gravity], other[~is_gravity], atol=2e-5)
    assert not np.allclose(one[is_gravity], other[is_gravity])


def test_centerline_tangent_and_way_on_are_told_beside_it():
    simulation = simulation_of()
    down = np.array([0.0, 0.0, -1.0])
    simulation.worlds.T_world_capsule[0, :3, 3] += 5e-3 * down
    told = _told(simulation.view, frame="world")[0].astype(float)
    np.testing.assert_allclose(told[5:8], -down * 5e-3 / 25e-3, atol=1e-5)
    np.testing.assert_allclose(told[8:11], [1.0, 0.0, 0.0], atol=1e-6)
    ahead = np.array([40e-3, 0.0, 5e-3])
    np.testing.assert_allclose(told[11:14], ahead / np.linalg.norm(ahead), atol=1e-5)
    assert told[0] == pytest.approx(0.5, abs=0.01)
    np.testing.assert_allclose(told[15:18], simulation.worlds.T_world_capsule[0, :3, 2], atol=1e-6)


def test_most_attractive_region_is_where_nothing_was_seen():
    simulation = simulation_of(start=Start(fraction=(0.2, 0.2), settle=0.0))
    simulation.coverage.cells[:] = simulation.coverage.cell_area
    left = simulation.coverage.cell_center[0, :, 0] > 0.14
    simulation.coverage.cells[0, left] = 0.0
    first, second = _told(simulation.view, frame="world", regions=6)[0, 41:55].reshape(2, 7)
    assert first[0] > 0.9 and first[4] > 0.0  # towards the anal end
    assert 0.14 - 0.036 < _distance(first[3]) < 0.18 - 0.03
    assert first[6] == 1.0  # nothing is in between
    unseen = simulation.coverage.unseen_cells.sum()
    assert 0.0 < 0.01 * first[5] / (1.0 - first[5]) < unseen
    assert second[5] > 0.0


def test_nothing_left_to_see_is_zeros():
    simulation = simulation_of()
    simulation.coverage.cells[:] = simulation.coverage.cell_area
    assert not _told(simulation.view)[0, 41:].any()
    assert _told(simulation.view, regions=64).shape == (1, 41 + 7 * 64)


def test_region_behind_a_wall_is_not_free():
    simulation = simulation_of()
    simulation.coverage.cells[:] = simulation.coverage.cell_area
    cell = np.argmax(simulation.coverage.cell_area[0])
    simulation.coverage.cells[0, cell] = 0.0
    place, center = simulation.worlds.T_world_capsule[0, :3, 3], simulation.coverage.cell_center[0]
    center[cell] = place + np.array([0.0, 0.05, 0.0])
    assert _told(simulation.view, regions=1)[0, -1] == 0.0
    center[cell] = place + np.array([0.0, 0.015, 0.0])
    assert _told(simulation.view, regions=1)[0, -1] == 1.0


def test_worlds_side_by_side_are_told_what_each_is_told_alone():
    many = simulation_of(3, organs=(GUT, SHORT_GUT), start=Start(settle=0.0))
    told = _told(many.view)
    assert told.dtype == np.float32 and np.abs(told).max() <= 1.0
    assert LandmarksObservation().space(many.view).contains(told[0])
    for index in range(3):
        alone = simulation_of(1, organs=(GUT, SHORT_GUT), start=Start(settle=0.0))
        alone.reset(0, np.random.default_rng(index))
        np.testing.assert_array_equal(_told(alone.view)[0], told[index])


def test_magnet_is_told_from_the_capsule():
    simulation = simulation_of()
    T_magnet = simulation.memory.allocate("magnet/T", (4, 4))
    place = simulation.worlds.T_world_capsule[0, :3, 3]
    T_magnet[0] = transform_from(np.eye(3), place + np.array([0.0, 0.0, 0.1]))
    told = _told(simulation.view, frame="world")[0]
    np.testing.assert_allclose(told[-6:], [0.0, 0.0, 0.5, 0.0, 0.0, 1.0], atol=1e-6)
    assert LandmarksObservation().space(simulation.view).shape == told.shape


def test_way_to_the_goal_is_told_where_there_is_one():
    simulation = simulation_of(task=NavigateTask(goal=0.25))
    told = _told(simulation.view)[0]
    assert LandmarksObservation().space(simulation.view).contains(told) and len(told) == 83 + 6 + 1
    assert told[-1] == pytest.approx(-0.045 / 0.145, abs=1e-3)


def test_bad_options_say_what_is_allowed():
    with pytest.raises(InputError, match=r"regions is -1\. Allowed: 0 to 64"):
        LandmarksObservation(regions=-1)


def test_distances_in_many_walls_are_those_of_single_rays():
    walls = [wall_of(organ.vertices, organ.faces) for organ in (GUT, SHORT_GUT)]
    ways = np.random.default_rng(0).normal(size=(2, 40, 3))
    places = np.array([[0.05, 1e-3, 2e-3], [0.03, -4e-3, 0.0]])
    found = _core.wall_distances(walls, places, ways, 0.04)
    for wall, place, way, row in zip(walls, places, ways, found, strict=True):
        units = way / np.linalg.norm(way, axis=1, keepdims=True)
        alone, _ = wall.cast(np.tile(place, (40, 1)), units)
        np.testing.assert_allclose(row, np.minimum(alone, 0.04), rtol=1e-5)
    with pytest.raises(ValueError, match=r"need a position \[3\] and directions"):
        _core.wall_distances(walls, places, ways[:1], 0.04)
    with pytest.raises(ValueError, match="must be finite, and not zero"):
        _core.wall_distances(walls, places, 0.0 * ways, 0.04)
