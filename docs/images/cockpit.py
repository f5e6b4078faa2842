"""Take the pictures of the cockpit: a stomach that is driven through, and an episode of it.

A magnet on a Panda leads the capsule by held keys; the pictures are of a headless Chromium.

python -m docs.images.cockpit
"""

from __future__ import annotations

import shutil
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from playwright.sync_api import Page, sync_playwright

from vrcaps.cli.cockpit import Cockpit as CockpitCommand
from vrcaps.cockpit.cockpit import Cockpit, open_cockpit
from vrcaps.cockpit.episodes.episode_page import open_episodes
from vrcaps.cockpit.panels.scene_panels import ScenePanel
from vrcaps.recording.recorder import record

FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
SIZE = {"width": 1400, "height": 800}
PORT = 8941
NEAR = np.array([0.03, -0.08, 0.05])
"""From where the capsule is looked at closely [m]."""
KEYS = (("a", 1.0), ("s", 1.5), ("e", 1.5))
"""Keys, and for how much simulated time each is held [s]."""
MAX_FRAMES = 40


def main(path: Path) -> None:
    """Drive, record, and take the pictures."""
    folder = Path(tempfile.mkdtemp())
    program = shutil.which("chromium") or shutil.which("chromium-browser")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=FLAGS)
        with open_cockpit(CockpitCommand().resolved(), folder / "drive", port=PORT) as cockpit:
            tab = opened(browser.new_page(viewport=SIZE), cockpit.gate.address)
            drive(tab, cockpit, path)
            scenario = cockpit.session.drive.save()
        scenario = replace(scenario, frames=min(scenario.frames, MAX_FRAMES))
        episode = record(scenario, folder / "episode")
        with open_episodes([episode], port=PORT) as (page, gate):
            tab = opened(browser.new_page(viewport=SIZE), gate.address)
            tab.get_by_label("Channel").first.click()
            tab.get_by_role("option", name="depth", exact=True).click()
            page._frame.value = scenario.frames - 1
            tab.wait_for_timeout(4000)
            take(tab, path.with_stem("cockpit_view"))
        browser.close()
    shutil.rmtree(folder)


def opened(tab: Page, address: str) -> Page:
    """A page with its scene."""
    tab.goto(address)
    tab.locator("img[src^='blob:']").first.wait_for()
    tab.wait_for_timeout(3000)
    return tab


def drive(tab: Page, cockpit: Cockpit, path: Path) -> None:
    """Holds keys, and takes pictures of three tabs and of the touched wall."""
    for key, duration in KEYS:
        view = cockpit.session.view
        assert view is not None
        end = view.state.time + duration
        tab.keyboard.down(key)
        while cockpit.session.view.state.time < end:  # type: ignore[union-attr]
            tab.wait_for_timeout(20)
        tab.keyboard.up(key)
    tab.get_by_text("Keys and gamepad").click()
    tab.wait_for_timeout(2000)
    take(tab, path)
    for folder in ("Keys and gamepad", "Run", "Scene"):
        tab.get_by_text(folder, exact=True).click()
    scene = next(panel for panel in cockpit.page.panels if isinstance(panel, ScenePanel))
    scene._color.value = "coverage"
    tab.get_by_text("Map", exact=True).click()
    tab.wait_for_timeout(4000)
    take(tab, path.with_stem("cockpit_coverage"))
    tab.get_by_text("Charts", exact=True).click()
    tab.wait_for_timeout(2000)
    take(tab, path.with_stem("cockpit_charts"))
    scene._color.value, scene._cut_axis.value = "contact pressure", "y"
    look_at_capsule(cockpit)
    tab.wait_for_timeout(4000)
    take(tab, path.with_stem("cockpit_pressure"))


def look_at_capsule(cockpit: Cockpit) -> None:
    """Brings the view of the scene near the capsule."""
    view = cockpit.session.view
    assert view is not None
    place = view.state.T_world_capsule[:3, 3]
    for client in cockpit.page.server.get_clients().values():
        client.camera.look_at = place
        client.camera.position = place + NEAR


def take(tab: Page, path: Path) -> None:
    """Writes a picture without messages."""
    closing = "document.querySelectorAll('.mantine-Notification-closeButton')"
    tab.evaluate(f"{closing}.forEach((button) => button.click())")
    tab.wait_for_timeout(600)
    tab.screenshot(path=path, type="jpeg", quality=85)


if __name__ == "__main__":
    main(Path(__file__).with_suffix(".jpg"))
