"""A capsule led to a place on the wall, and what is said when it does not get there."""

from __future__ import annotations

import numpy as np
import pytest

from tubes import straight_gut
from vrcaps.actuation.capsule_target import CapsuleTarget, wall_target
from vrcaps.actuation.magnet_actuator import FreeActuator
from vrcaps.actuation.magnet_controller import MagnetController
from vrcaps.actuation.magnet_pose_solver import Workspace
from vrcaps.actuation.point_to_point import PointToPointPlanner
from vrcaps.capsule.catalog import read_device
from vrcaps.core.errors import InputError
from vrcaps.magnet.presets import read_magnet
from vrcaps.magnet.sources import magnet_pose
from vrcaps.tissue.tissue import Tissue
from vrcaps.world.model import Model, State
from vrcaps.world.world import World

DT = 0.01
AHEAD = np.array([1.0, 0.0, 0.0])


def on_wall(model: Model, x: float) -> CapsuleTarget:
    return wall_target(model, np.array([x, 0.0, 0.01]), AHEAD)


def begin(actuator: FreeActuator) -> tuple[MagnetController, World]:
    """A capsule under the upper wall of a tube along x, at 0.1 m."""
    gut = straight_gut({"jejunum": 0.2}, radius=0.014)
    model = Model(gut, read_device("magnetic"), np.eye(4))
    target = on_wall(model, 0.1)
    pose = magnet_pose(np.asarray(target.position) - [0, 0, 1e-3], AHEAD)
    controller = MagnetController(model, read_magnet("cylinder-101.6"), actuator, pose, target)
    return controller, World(
        model, Tissue(), State(0.0, pose), sources=controller.sources, substep=2e-4
    )


def run(planner: PointToPointPlanner, world: World, most: float) -> None:
    while not (planner.is_settled or planner.has_failed or world.time > most):
        world.step(planner.control(world, DT), DT)


@pytest.mark.slow
def test_leads_the_capsule_to_the_target():
    controller, world = begin(FreeActuator())
    target = on_wall(controller.model, 0.115)
    planner = PointToPointPlanner(controller, world.T_world_capsule, target)
    run(planner, world, 6.0)
    assert planner.is_settled
    assert not planner.has_failed
    assert controller.status.lost == ""
    off = world.T_world_capsule[:3, 3] - np.asarray(target.position)
    assert np.linalg.norm(off[:2]) < 1e-3  # the soft wall yields by 1 mm in z
    assert world.T_world_capsule[:3, 2] @ AHEAD > np.cos(np.radians(3.0))


@pytest.mark.slow
def test_tries_anew_and_says_that_it_failed():
    """A magnet that cannot leave its place leads the capsule nowhere."""
    free, _ = begin(FreeActuator())
    x, y, z = free.status.actuator.T_world_magnet[:3, 3].tolist()
    tied = FreeActuator(
        Workspace(low=(x - 1e-3, y - 1e-3, z - 1e-3), high=(x + 1e-3, y + 1e-3, z + 5e-2))
    )
    controller, world = begin(tied)
    planner = PointToPointPlanner(
        controller, world.T_world_capsule, on_wall(controller.model, 0.12), attempts=2, timeout=0.5
    )
    run(planner, world, 8.0)
    assert planner.has_failed
    assert planner.attempts == 0
    assert not planner.is_settled
    assert controller.status.lost


def test_needs_a_try():
    controller, world = begin(FreeActuator())
    target = on_wall(controller.model, 0.1)
    with pytest.raises(InputError, match="attempts is 0"):
        PointToPointPlanner(controller, world.T_world_capsule, target, attempts=0)
