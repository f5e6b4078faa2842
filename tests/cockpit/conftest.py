"""A short gut and a magnetic capsule with a small camera, and the page in a real browser."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from tests.support.cockpit_browser import free_port
from tests.support.small_episode import *  # noqa: F403
from tests.support.tubes import straight_gut
from vrcaps.actuation.steering_program import MagnetSteering
from vrcaps.camera.derive import scaled_camera
from vrcaps.camera_pipeline.effects import Effects
from vrcaps.capsule.device_file import read_device
from vrcaps.motion.dynamics import Dynamics
from vrcaps.organ.organ_file import write_organ
from vrcaps.scenario.scenario import Scenario

if TYPE_CHECKING:
    from playwright.sync_api import Browser

    from vrcaps.cockpit.cockpit import Cockpit


@pytest.fixture(scope="session")
def drive_scenario(tmp_path_factory: pytest.TempPathFactory) -> Scenario:
    """The magnet moves freely: an arm is tested where it is."""
    file = tmp_path_factory.mktemp("gut") / "gut.glb"
    write_organ(file, straight_gut({"jejunum": 0.2}, radius=0.014))
    device = read_device("magnetic")
    device = replace(device, cameras=(scaled_camera(device.cameras[0], 0.25),))
    motion = Dynamics(start=0.3, settle=0.2, substep=5e-4, magnet=MagnetSteering())
    return Scenario(
        str(file),
        capsule=device,
        motion=motion,
        fps=10.0,
        channels=("rgb",),
        effects=Effects.none(),  # images equal the renderer's
    )


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what needs a browser."""
    for item in items:
        if "browser" in getattr(item, "fixturenames", ()):
            item.add_marker("browser")


def chromium() -> str:
    """Path of the system's Chromium; skips the test where there is none."""
    pytest.importorskip("viser", reason="the extra cockpit is not installed")
    pytest.importorskip("playwright", reason="playwright is not installed")
    found = shutil.which("chromium") or shutil.which("chromium-browser")
    if found is None:
        pytest.skip("no Chromium: apt-get install chromium")
    return found


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Chromium without a window, which draws without a graphics card."""
    program = chromium()
    from playwright.sync_api import sync_playwright

    flags = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    with sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=program, args=flags)
        yield opened
        opened.close()


@pytest.fixture(scope="module")
def cockpit(
    drive_scenario: Scenario, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Cockpit]:
    """An open cockpit."""
    pytest.importorskip("viser", reason="the extra cockpit is not installed")
    from vrcaps.cockpit.cockpit import open_cockpit

    folder = tmp_path_factory.mktemp("drive") / "drive"
    with open_cockpit(drive_scenario, folder, port=free_port()) as opened:
        yield opened
