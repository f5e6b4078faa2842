"""Small worlds for a bridge: a capsule in a tube, steered by a magnet or by coils."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.support.small_drive import small_drive
from vrcaps.actuation.coil_program import CoilSteering
from vrcaps.camera.camera import Camera
from vrcaps.camera.lens import LensPinhole
from vrcaps.scenario.scenario import Scenario


@pytest.fixture(scope="session")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> Scenario:
    """The camera has a lens that ROS can describe."""
    given = small_drive(tmp_path_factory.mktemp("gut") / "gut.glb")
    lens = LensPinhole(fx=20.0, fy=20.0, cx=15.5, cy=11.5)
    camera = Camera("front", lens, 32, 24, leds=given.device.cameras[0].leds)
    device = replace(given.device, cameras=(camera,))
    motion = replace(given.motion, dynamics="quasi-static", substep=1e-3)
    return replace(given, capsule=device, motion=motion)


@pytest.fixture(scope="session")
def coil_scenario(scenario: Scenario) -> Scenario:
    """Nine coils below the tube."""
    motion = replace(scenario.motion, magnet=None, coils=CoilSteering())
    return replace(scenario, motion=motion)
