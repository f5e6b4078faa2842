"""The map of what was seen: whole, and in crops about the capsule."""

import numpy as np
import pytest

from tests.support.small_envs import GUT, SHORT_GUT, simulation_of
from vrcaps.env.observations import MapObservation
from vrcaps.env.randomization import Start

_ROWS, _COLUMNS = 18, 12


def _painted(num_worlds=1):
    """Worlds whose cells were seen to shares drawn at random."""
    simulation = simulation_of(num_worlds, start=Start(settle=0.0), organs=(GUT, SHORT_GUT))
    shares = np.random.default_rng(1).random(simulation.coverage.cells.shape)
    simulation.coverage.cells[:] = shares * simulation.coverage.cell_area
    return simulation, shares.reshape(-1, _ROWS, _COLUMNS)


def test_map_is_the_share_of_each_cell_and_the_capsules_place():
    simulation, shares = _painted(2)
    told = MapObservation().observe(simulation.view)
    has_wall = simulation.coverage.cell_area.reshape(shares.shape) > 0.0
    np.testing.assert_allclose(told[:, 0], np.where(has_wall, shares, 1.0), atol=1e-6)
    assert told[:, 1].sum(axis=(1, 2)).tolist() == [1.0, 1.0]
    row = told[:, 1].argmax(axis=2).max(axis=1).nonzero()[0]
    expected = (simulation.worlds.arc_length / simulation.worlds.course.length * _ROWS).astype(int)
    assert told[np.arange(2), 1, expected].sum(axis=1).tolist() == [1.0, 1.0], row


def test_first_look_of_a_camera_is_ahead_of_the_capsule():
    simulation = simulation_of()
    seen, place = MapObservation().observe(simulation.view)[0]
    row = int(place.sum(axis=1).argmax())
    assert seen[row + 4 : -1].mean() > 0.9 and seen[: row - 1].max() == 0.0


def _mean_by_samples(simulation, shares, scale, pixel, option):
    """Share seen, and share in the gut, of a pixel by many samples."""
    draw = np.random.default_rng(0).random((20000, 2))
    half = 0.5 * option.size * option.factor**scale
    s = simulation.worlds.arc_length[0] / simulation.worlds.course.length[0] * _ROWS
    row = s - half + (pixel[0] + draw[:, 0]) * option.factor**scale
    here = simulation.worlds.course.at(simulation.worlds.arc_length)
    x, y, _ = here.axes[0] @ (simulation.worlds.T_world_capsule[0, :3, 3] - here.point[0])
    turn = np.arctan2(y, x) / (2 * np.pi) + 0.5
    column = turn * _COLUMNS - half + (pixel[1] + draw[:, 1]) * option.factor**scale
    inside = (row >= 0.0) & (row < _ROWS)
    at = np.floor(row[inside]).astype(int), np.floor(column[inside]).astype(int) % _COLUMNS
    area = simulation.coverage.cell_area[0].reshape(_ROWS, _COLUMNS)[at]
    return (shares[0][at] * area).sum() / max(area.sum(), 1e-12), inside.mean()


@pytest.mark.parametrize("scale, pixel", [(0, (7, 7)), (1, (4, 15)), (2, (6, 0)), (3, (15, 3))])
def test_crop_is_the_mean_over_what_a_pixel_covers(scale, pixel):
    simulation, shares = _painted()
    option = MapObservation(egocentric=True)
    told = option.observe(simulation.view)
    assert told.shape == (1, 8, 16, 16) == (1, *option.space(simulation.view).shape)
    share, inside = _mean_by_samples(simulation, shares, scale, pixel, option)
    assert told[0, 2 * scale][pixel] == pytest.approx(share, abs=0.02)
    assert told[0, 2 * scale + 1][pixel] == pytest.approx(inside, abs=0.02)


def test_crop_turns_with_the_capsule_about_the_centerline():
    simulation, _ = _painted()
    option = MapObservation(egocentric=True)
    here = simulation.worlds.course.at(simulation.worlds.arc_length)
    pictures = []
    for turn in (0.25, 0.25 + 2.0 * np.pi / _COLUMNS):
        x, y, _ = here.axes[0]
        offset = 3e-3 * (np.cos(turn) * x + np.sin(turn) * y)
        simulation.worlds.T_world_capsule[0, :3, 3] = here.point[0] + offset
        pictures.append(option.observe(simulation.view)[0, 0])
    np.testing.assert_allclose(pictures[0][:, 1:], pictures[1][:, :-1], atol=1e-5)


def test_worlds_side_by_side_are_shown_what_each_is_shown_alone():
    simulation, _ = _painted(3)
    together = MapObservation(egocentric=True).observe(simulation.view)
    assert MapObservation(egocentric=True).space(simulation.view).contains(together[0])
    for index in range(3):
        alone, _ = _painted(1)
        alone.reset(0, np.random.default_rng(index))
        alone.coverage.cells[:] = simulation.coverage.cells[index]
        told = MapObservation(egocentric=True).observe(alone.view)[0]
        np.testing.assert_array_equal(told, together[index])
