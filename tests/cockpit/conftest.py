"""A short gut and a magnetic capsule with a small camera, and the page in a real browser."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest

from tests.support.cockpit_browser import free_port
from tests.support.small_drive import small_drive
from tests.support.small_episode import *  # noqa: F403
from vrcaps.scenario.scenario import Scenario

if TYPE_CHECKING:
    from playwright.sync_api import Browser

    from vrcaps.cockpit.cockpit import Cockpit


@pytest.fixture(scope="session")
def drive_scenario(tmp_path_factory: pytest.TempPathFactory) -> Scenario:
    return small_drive(tmp_path_factory.mktemp("gut") / "gut.glb")


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
