"""Take the pictures of the cockpit: a stomach that is driven through, and an episode of it.

A magnet on a Panda leads the capsule by held keys, and in the episode along the wall; the pictures
are of a headless Chromium.

python -m docs.images.cockpit [drive] [view]
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Collection
from pathlib import Path

from playwright.sync_api import Page, sync_playwright

from vrcaps.actuation.steering_program import MagnetSteering
from vrcaps.cli.cockpit import Cockpit as CockpitCommand
from vrcaps.cockpit.cockpit import Cockpit, open_cockpit
from vrcaps.cockpit.episode_page import open_episodes
from vrcaps.motion.dynamics import Dynamics
from vrcaps.recording.recorder import record
from vrcaps.render.settings import RenderSettings
from vrcaps.scenario.scenario import Scenario

FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
SIZES = {"cockpit_small": (900, 600), "cockpit_tablet": (1024, 768), "cockpit_large": (1920, 1080)}
SIZE = (1400, 800)
PORT = 8941
KEYS = (("a", 1.0), ("s", 1.5), ("e", 1.0))
"""Keys, and for how much simulated time each is held [s]."""
EPISODE = Scenario(
    "stomach",
    "magnetic",
    motion=Dynamics(magnet=MagnetSteering(arm="panda", speed=0.02)),
    frames=24,
    channels=("rgb", "depth"),
    render=RenderSettings(light="direct"),
)


def main(path: Path, parts: Collection[str]) -> None:
    """Take the pictures of a drive, of an episode, or of both."""
    folder = Path(tempfile.mkdtemp())
    program = shutil.which("chromium") or shutil.which("chromium-browser")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=FLAGS)
        if "drive" in parts:
            with open_cockpit(CockpitCommand().resolved(), folder / "drive", port=PORT) as cockpit:
                tab = browser.new_page()
                tab.add_init_script("localStorage.setItem('vrcaps-tour', 'seen')")
                opened(tab, cockpit.gate.address)
                drive(tab, cockpit)
                take_drive(tab, path)
        if "view" in parts:
            with open_episodes([record(EPISODE, folder / "stomach")], port=PORT) as (page, gate):
                tab = opened(browser.new_page(), gate.address)
                tab.get_by_label("Channel").select_option("depth")
                page.select(EPISODE.frames - 1)
                take(tab, path.with_stem("cockpit_view"))
        browser.close()
    shutil.rmtree(folder)


def opened(tab: Page, address: str) -> Page:
    """A page with its scene."""
    tab.set_viewport_size({"width": SIZE[0], "height": SIZE[1]})
    tab.goto(address)
    tab.locator("img[src^='blob:']").first.wait_for()
    tab.wait_for_timeout(5000)
    return tab


def drive(tab: Page, cockpit: Cockpit) -> None:
    """Hold keys, and frame the capsule."""
    for key, duration in KEYS:
        view = cockpit.session.view
        assert view is not None
        end = view.state.time + duration
        tab.keyboard.down(key)
        while cockpit.session.view.state.time < end:  # type: ignore[union-attr]
            tab.wait_for_timeout(20)
        tab.keyboard.up(key)
    tab.keyboard.press("c")


def take_drive(tab: Page, path: Path) -> None:
    """Take pictures of all sizes, of coverage, of charts and of the touched wall."""
    take(tab, path)
    for name, (width, height) in SIZES.items():
        tab.set_viewport_size({"width": width, "height": height})
        take(tab, path.with_stem(name))
    tab.set_viewport_size({"width": SIZE[0], "height": SIZE[1]})
    tab.locator("#tab-scene").click()
    tab.get_by_label("Color by", exact=True).select_option("coverage")
    tab.keyboard.press("v")
    take(tab, path.with_stem("cockpit_coverage"))
    tab.get_by_label("Color by", exact=True).select_option("contact pressure")
    tab.keyboard.press("c")
    take(tab, path.with_stem("cockpit_pressure"))


def take(tab: Page, path: Path) -> None:
    """Wait until the page is redrawn, then write a picture of it."""
    tab.wait_for_timeout(5000)
    tab.screenshot(path=path, type="jpeg", quality=85)


if __name__ == "__main__":
    main(Path(__file__).with_suffix(".jpg"), sys.argv[1:] or ("drive", "view"))
