"""The propulsive law against its printed form."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.tubes import straight_gut
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.units import CM, MM
from vrcaps.organ.surface import Centerline
from vrcaps.tissue.motility.motility import Motility, Propulsion
from vrcaps.tissue.motility.muscle import Muscle


def _ring(radius: float = 0.05) -> Centerline:
    """Half a circle in the plane, from (r, 0, 0) by (0, r, 0) to (−r, 0, 0)."""
    angle = np.linspace(0.0, np.pi, 201)
    points = radius * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], -1)
    tangent = np.stack([-np.sin(angle), np.cos(angle), 0.0 * angle], -1)
    frames = np.zeros((201, 3, 3))
    frames[:, :, 2] = tangent
    return Centerline(points, radius * angle, np.full(201, 0.01), frames)


def test_direction_of_a_segment_is_from_its_start_to_its_end() -> None:
    line = _ring()
    law = Propulsion(segment_length=line.length / 2.0)
    np.testing.assert_allclose(
        law.unit_vector(line, 0.0), np.array([-1, 1, 0]) / np.sqrt(2), atol=1e-3
    )
    np.testing.assert_allclose(
        law.unit_vector(line, 0.1), np.array([-1, -1, 0]) / np.sqrt(2), atol=1e-3
    )
    np.testing.assert_allclose(
        law.unit_vector(line, 1.0), np.array([-1, -1, 0]) / np.sqrt(2), atol=1e-3
    )
    tangent = Propulsion(direction="tangent").unit_vector(line, line.length / 2.0)
    np.testing.assert_allclose(tangent, [-1.0, 0.0, 0.0], atol=1e-3)


def test_force_is_beta_times_the_difference_of_velocities(rng: np.random.Generator) -> None:
    organ = straight_gut({"jejunum": 0.3})
    law = Propulsion(beta=2.0, alpha=3.0 * CM)
    muscle = Muscle(organ, Motility(complex=None, propulsion=law), rng)
    velocity = rng.normal(size=3)
    force = muscle.propulsion(np.array([0.1, 0.0, 0.0]), velocity, 5.0)
    np.testing.assert_allclose(force, 2.0 * (np.array([3.0 * CM, 0.0, 0.0]) - velocity))


def test_default_speed_is_that_of_the_contractions(rng: np.random.Generator) -> None:
    """9.3 g at rest where they run at 2 cm/s."""
    organ = straight_gut({"duodenum": 0.3})
    muscle = Muscle(organ, Motility(complex=None, propulsion=Propulsion()), rng)
    force = muscle.propulsion(np.array([0.1, 1.0 * MM, 0.0]), np.zeros(3), 5.0)
    assert force[0] == pytest.approx(9.3e-3 * 9.81, rel=0.02)
    assert not force[1:].any()


def test_no_force_in_the_first_phase(rng: np.random.Generator) -> None:
    organ = straight_gut({"duodenum": 0.25, "jejunum": 0.3})
    muscle = Muscle(organ, Motility(propulsion=Propulsion()), rng)
    place, here = np.array([0.3]), np.array([0.3, 0.0, 0.0])
    times = np.arange(0.0, 8 * 3600.0, 120.0)
    phase = np.array([muscle.phase(place, t)[0] for t in times])
    assert {1, 2} <= set(phase)
    for time, number in zip(times, phase, strict=True):
        force = muscle.propulsion(here, np.zeros(3), time)[0]
        assert (force == 0.0) == (number == 1)


def test_no_law_no_force(rng: np.random.Generator) -> None:
    muscle = Muscle(straight_gut({"duodenum": 0.25}), Motility(), rng)
    assert not muscle.propulsion(np.zeros(3), np.ones(3), 0.0).any()


@pytest.mark.parametrize(
    ("field", "value", "match"),
    [
        ("beta", -1.0, "beta is -1.0. Allowed: 0 N·s/m or more"),
        ("alpha", float("nan"), "alpha is nan. Allowed: 0 m/s or more, or None"),
        ("segment_length", 0.0, "segment_length is 0.0. Allowed: above 0 m"),
    ],
)
def test_rejects(field: str, value: float, match: str) -> None:
    with pytest.raises(InputError, match=match):
        Propulsion(**{field: value})


def test_rejects_an_unknown_direction() -> None:
    with pytest.raises(UnknownNameError, match=r"No direction named 'up'. Known: segment, tangent"):
        Propulsion(direction="up")
