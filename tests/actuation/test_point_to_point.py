"""A capsule led to a place on the wall, and what is said when it does not get there."""

from __future__ import annotations

import numpy as np
import pytest

from tubes import straight_gut
from vrcaps.actuation.capsule_target import Goal, wall_goal
from vrcaps.actuation.magnet_actuator import FreeHolder
from vrcaps.actuation.magnet_controller import Pilot
from vrcaps.actuation.magnet_pose_solver import Room
from vrcaps.actuation.point_to_point import Guide
from vrcaps.capsule.catalog import read_device
from vrcaps.errors import InputError
from vrcaps.magnet.presets import load_magnet
from vrcaps.magnet.sources import magnet_pose
from vrcaps.tissue.tissue import Tissue
from vrcaps.world.model import Model, State
from vrcaps.world.world import World

DT = 0.01
AHEAD = np.array([1.0, 0.0, 0.0])


def on_wall(model: Model, x: float) -> Goal:
    return wall_goal(model, np.array([x, 0.0, 0.01]), AHEAD)


def begin(holder: FreeHolder) -> tuple[Pilot, World]:
    """A capsule under the upper wall of a tube along x, at 0.1 m."""
    gut = straight_gut({"jejunum": 0.2}, radius=0.014)
    model = Model(gut, read_device("magnetic"), np.eye(4))
    goal = on_wall(model, 0.1)
    pose = magnet_pose(np.asarray(goal.position) - [0, 0, 1e-3], AHEAD)
    pilot = Pilot(model, load_magnet("cylinder-101.6"), holder, pose, goal)
    return pilot, World(model, Tissue(), State(0.0, pose), sources=pilot.sources, substep=2e-4)


def run(guide: Guide, world: World, most: float) -> None:
    while not (guide.settled or guide.failed or world.time > most):
        world.step(guide.control(world, DT), DT)


def test_leads_the_capsule_to_the_goal():
    pilot, world = begin(FreeHolder())
    goal = on_wall(pilot.model, 0.115)
    guide = Guide(pilot, world.T_world_capsule, goal)
    run(guide, world, 6.0)
    assert guide.settled
    assert not guide.failed
    assert pilot.steered.lost == ""
    off = world.T_world_capsule[:3, 3] - np.asarray(goal.position)
    assert np.linalg.norm(off[:2]) < 1e-3  # the soft wall yields by 1 mm in z
    assert world.T_world_capsule[:3, 2] @ AHEAD > np.cos(np.radians(3.0))


def test_tries_anew_and_says_that_it_failed():
    """A magnet that cannot leave its place leads the capsule nowhere."""
    free, _ = begin(FreeHolder())
    x, y, z = free.steered.held.T_world_magnet[:3, 3].tolist()
    tied = FreeHolder(Room(low=(x - 1e-3, y - 1e-3, z - 1e-3), high=(x + 1e-3, y + 1e-3, z + 5e-2)))
    pilot, world = begin(tied)
    guide = Guide(pilot, world.T_world_capsule, on_wall(pilot.model, 0.12), tries=2, patience=0.5)
    run(guide, world, 8.0)
    assert guide.failed
    assert guide.tries == 0
    assert not guide.settled
    assert pilot.steered.lost


def test_needs_a_try():
    pilot, world = begin(FreeHolder())
    goal = on_wall(pilot.model, 0.1)
    with pytest.raises(InputError, match="tries is 0"):
        Guide(pilot, world.T_world_capsule, goal, tries=0)
