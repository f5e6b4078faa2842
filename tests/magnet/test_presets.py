"""Magnets by name: the moments and distances that are published or stated."""

from __future__ import annotations

import numpy as np
import pytest

from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.magnet.field import field
from vrcaps.magnet.presets import (
    GRADES,
    MAGNETS,
    dipole_distance,
    magnet_names,
    read_magnet,
    remanence_of,
)
from vrcaps.magnet.sources import Dipole


@pytest.mark.parametrize(("name", "moment"), [("cylinder-101.6", 970.1), ("capsule-11x10", 1.12)])
def test_published_moments(name, moment):
    """B_r V/μ₀."""
    assert abs(read_magnet(name).moment / moment - 1) < 1e-3


@pytest.mark.parametrize("name", magnet_names())
def test_every_magnet_is_of_its_grade_and_stands_where_it_is_put(name):
    low, high = GRADES[MAGNETS[name].grade]
    assert low <= MAGNETS[name].remanence <= high
    pose = np.eye(4)
    pose[:3, 3] = [1, 2, 3]
    assert np.array_equal(read_magnet(name, pose).T_world_magnet, pose)


@pytest.mark.parametrize("name", magnet_names())
def test_dipole_distance_is_where_the_error_is_5_percent(name):
    magnet = read_magnet(name)
    distance = dipole_distance(magnet)
    angles = np.linspace(0, np.pi / 2, 181)
    rays = np.stack([np.sin(angles), 0 * angles, np.cos(angles)], axis=1)

    def error(r: float) -> float:
        exact = field([magnet], r * rays)[0]
        approximate = field([Dipole(magnet.moment)], r * rays)[0]
        return (np.linalg.norm(exact - approximate, axis=1) / np.linalg.norm(exact, axis=1)).max()

    assert error(distance) < 0.0501
    assert error(0.99 * distance) > 0.05
    assert all(error(k * distance) < 0.05 for k in (1.01, 1.2, 1.5, 2, 5))


def test_remanence_of_a_grade():
    assert remanence_of("N52", part=0) == 1.43
    assert remanence_of("N52", part=1) == 1.48
    np.testing.assert_allclose(remanence_of("N35"), 1.195)


def test_unknown_names_and_values():
    with pytest.raises(UnknownNameError, match=r"No magnet named 'big'\. Known: capsule-11x10, "):
        read_magnet("big")
    with pytest.raises(UnknownNameError, match=r"No grade named 'N99'\. Known: N35, "):
        remanence_of("N99")
    with pytest.raises(InputError, match=r"part is 2\. Allowed: 0 to 1\."):
        remanence_of("N52", part=2)
    with pytest.raises(InputError, match=r"error is 0\. Allowed: 1e-6 to below 1\."):
        dipole_distance(read_magnet("capsule-6x6"), error=0)
