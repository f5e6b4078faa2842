"""Drag of what fills the lumen, under both dynamics, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.walls import floor, world_on
from vrcaps import _core
from vrcaps.core.errors import InputError
from vrcaps.core.units import MM
from vrcaps.tissue.tissue import Drag, Tissue
from vrcaps.world.model import Model
from vrcaps.world.world import World

FREE, STILL = (0.0,) * 6, (0.0,) * 3
MASS, ACROSS = 3e-3, 1.5e-7
SUBSTEPS = [5e-5, 1e-3]


def flying(tau: float | None, *, is_quasi_static: bool = False) -> _core.World:
    """A capsule far above a floor, with a velocity, and a spin about no principal axis."""
    return world_on(
        floor(20.0 * MM),
        position=(0.0, 0.0, 1.0),
        velocity=(0.3, -0.1, 0.2),
        spin=(4.0, 3.0, -5.0),
        drag=Drag(friction=0.0, relaxation_time=tau),
        is_quasi_static=is_quasi_static,
    )


@pytest.mark.parametrize("substep", SUBSTEPS)
def test_velocity_and_spin_decay(substep: float) -> None:
    """v = v₀ exp(−t/τ) and x = x₀ + v₀ τ (1 − exp(−t/τ)); energy falls as exp(−2t/τ)."""
    tau, time = 0.1, 0.25
    world = flying(tau)
    place, _, velocity, _ = map(np.array, world.pose)
    energy, share = world.kinetic_energy(), np.exp(-time / tau)
    world.step(substep, round(time / substep), FREE, STILL)
    np.testing.assert_allclose(world.pose[2], share * velocity, rtol=1e-4)
    np.testing.assert_allclose(world.pose[0], place + tau * (1 - share) * velocity, atol=1e-6)
    assert world.kinetic_energy() == pytest.approx(share**2 * energy, rel=1e-4)
    np.testing.assert_allclose(world.contact()[0], 0.0, atol=1e-12)
    np.testing.assert_allclose(world.contact()[1], 0.0, atol=1e-12)


@pytest.mark.parametrize("is_quasi_static", [False, True])
def test_a_force_and_a_torque_end_in_a_steady_twist(is_quasi_static: bool) -> None:
    """v = F τ/m, and about a principal axis ω = T τ/I."""
    tau, force, torque = 0.05, 2e-3, 1e-6
    world = flying(tau, is_quasi_static=is_quasi_static)
    world.pose = (*world.pose[:2], STILL, STILL)
    along_y = (0.0, force, 0.0, 0.0, torque, 0.0)  # the capsule's axis lies along −y
    across = (0.0, 0.0, 0.0, torque, 0.0, 0.0)
    world.step(1e-3, 1500, along_y, STILL)
    np.testing.assert_allclose(world.pose[2], (0.0, force * tau / MASS, 0.0), atol=1e-9)
    world.pose = (*world.pose[:2], STILL, STILL)
    world.step(1e-3, 1500, across, STILL)
    np.testing.assert_allclose(world.pose[3], (torque * tau / ACROSS, 0.0, 0.0), atol=1e-9)


def test_without_it_the_physics_keep_all_momentum() -> None:
    worlds = [flying(tau) for tau in (None, np.inf)]
    for world in worlds:
        world.step(1e-3, 100, FREE, STILL)
        assert tuple(world.pose[2]) == (0.3, -0.1, 0.2)
    assert worlds[0].pose == worlds[1].pose


def test_impossible_relaxation_times_are_one_line(model: Model) -> None:
    for tau in (0.0, -1.0, np.nan):
        with pytest.raises(InputError, match=r"relaxation_time is .* Allowed: 0.001 s or more"):
            Drag(relaxation_time=tau)
    with pytest.raises(InputError, match=r"quasi-static motion is inf. Allowed: up to 1000 s"):
        World(model, Tissue(drag=Drag(relaxation_time=np.inf)), dynamics="quasi-static")
