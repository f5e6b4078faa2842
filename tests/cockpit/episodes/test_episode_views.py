"""An estimated path is compared at the frames that it covers."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from vrcaps.cockpit.episode_views import COLUMNS, read_path_estimate, values_of
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import rotation_from_vector, transform_from

TIMES = np.arange(6) / 4.0


@pytest.fixture
def episode() -> Any:
    along = np.linspace(0.0, 1.0, 6)
    places = 0.1 * np.stack([along, along**2, np.sin(3.0 * along)], axis=1)
    columns = {f"capsule_v{axis}_m_per_s": np.full(6, 0.02) for axis in "xyz"}
    return SimpleNamespace(
        times=TIMES,
        Ts_world_capsule=transform_from(np.broadcast_to(np.eye(3), (6, 3, 3)), places),
        table=SimpleNamespace(columns=columns),
    )


def write_tum(path, times, places):
    rows = np.c_[times, places, np.tile([0.0, 0.0, 0.0, 1.0], (len(times), 1))]
    np.savetxt(path, rows, fmt="%.12f")


def test_a_path_that_is_turned_and_scaled_lies_on_the_true_one_after_alignment(episode, tmp_path):
    turn, path = rotation_from_vector(np.array([0.3, -0.5, 1.0])), tmp_path / "slam.txt"
    places = 2.5 * episode.Ts_world_capsule[:, :3, 3] @ turn.T + [0.3, 0.1, -0.2]
    write_tum(path, TIMES[1:], places[1:])
    given = read_path_estimate(path, episode)
    np.testing.assert_array_equal(given.frames, [1, 2, 3, 4, 5])
    assert (given.index_of(0), given.index_of(2)) == (None, 1)
    assert given.errors.min() > 0.1
    assert given.aligned("se3").errors.max() > 0.01
    np.testing.assert_allclose(given.aligned("sim3").errors, 0.0, atol=1e-9)
    np.testing.assert_array_equal(given.aligned("none").estimated, given.estimated)


def test_between_its_poses_the_estimate_is_interpolated(episode, tmp_path):
    path = tmp_path / "slam.txt"
    write_tum(path, [0.0, 1.0], [[0.0, 0.0, 0.0], [0.4, 0.0, 0.0]])
    given = read_path_estimate(path, episode)
    np.testing.assert_allclose(given.estimated[:, 0, 3], [0.0, 0.1, 0.2, 0.3, 0.4])


def test_an_estimate_of_other_times_is_told(episode, tmp_path):
    path = tmp_path / "slam.txt"
    write_tum(path, [1.7e9, 1.7e9 + 1.0], np.zeros((2, 3)))
    with pytest.raises(InputError, match=r"covers 1.7e\+09 s .* the episode 0 s to 1.25 s. Give"):
        read_path_estimate(path, episode)


def test_charts_show_what_an_episode_has(episode):
    speed = values_of(COLUMNS[0], episode)
    np.testing.assert_allclose(speed, 20.0 * np.sqrt(3.0))
    assert np.isnan(values_of(COLUMNS[2], episode)).all()
