"""Claim: on two cores the cockpit shows 20 images per second at real time, 150 ms after an input.

The stomach with magnet and Panda and a camera of 320², as `vrcaps cockpit` opens it. `no browser`
is the server's side alone: a client in a separate process takes the images over the page's
connection and draws nothing. The other rows are a headless Chromium that draws without a graphics
card, which takes much of the two cores; once with the scene in a small and once in a large window.
An image counts when the client has it, or the browser has decoded it: first while the magnet rests,
then while a key is held, so that magnet, arm and capsule move. For the latency the script
marks a corner of each image whose state came after a key was pressed: from the key's message, or
its event in the browser, to the first marked image there. Live images omit shadows at rates below
20 per second. A click counts from its event until the page has the acknowledgement of its command,
while the simulation runs.

    python -m benchmarks.speed.cockpit [--seconds 10] [--presses 12] [--no-browser]
"""

from __future__ import annotations

import multiprocessing
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from playwright.sync_api import Page, sync_playwright

from benchmarks.common.scripts import parser, table, write_section
from benchmarks.speed.cockpit_client import measure
from vrcaps.cli.cockpit import Cockpit as CockpitCommand
from vrcaps.cockpit.cockpit import Cockpit, open_cockpit
from vrcaps.cockpit.session.camera_images import ImageSettings, LiveImage
from vrcaps.cockpit.session.clock import View

FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
WINDOWS = {"small": ((900, 600), 0.2), "large": ((1400, 850), 1.0)}
"""Size of the page [px], and pixels of the scene per pixel of the page."""
MARK_PX = 40
WATCH = """
() => {
  const seen = window.seen = {images: [], marked: []};
  const canvas = document.createElement("canvas");
  const pen = canvas.getContext("2d", {willReadFrequently: true});
  canvas.width = canvas.height = 1;
  const look = (image) => {
    const now = performance.now();
    seen.images.push(now);
    pen.drawImage(image, 0, 0, 8, 8, 0, 0, 1, 1);
    const [r, g, b] = pen.getImageData(0, 0, 1, 1).data;
    seen.marked.push(r > 200 && g > 200 && b < 60);
  };
  document.addEventListener("load", (event) => {
    if (event.target.id === "camera-image") look(event.target);
  }, true);
}
"""
STEADY = """
() => {
  if (window.frames_drawn === undefined) {
    window.frames_drawn = 0;
    const draw = () => { window.frames_drawn += 1; requestAnimationFrame(draw); };
    draw();
  }
  return window.frames_drawn > 30;
}
"""
"""Return whether the browser draws: without a graphics card its first frames take seconds."""
PRESSES = """
localStorage.setItem("vrcaps-tour", "seen");
const note = (event) => { if (!event.repeat) window.pressed = performance.now(); };
window.addEventListener("keydown", note, true);
"""
"""Notes the time of a key's event, before the page itself sees it; the tour is not shown."""
CLICKS = 20
HEAD = (
    *("shown by", "at rest: speed / real time", "images per second"),
    *("driving: speed / real time", "images per second", "p10 of intervals [ms]", "p90"),
    *("input to image [ms]: median", "p90", "click to acknowledgement [ms]: median", "p90"),
    *("processor time of the server", "shadows"),
)


def main() -> None:
    """Measure, write the table."""
    made = parser(__doc__ or "")
    made.add_argument("--seconds", type=float, default=10.0, help="of each window")
    made.add_argument("--presses", type=int, default=12, help="of a key, in each window")
    made.add_argument("--no-browser", action="store_true", help="the server's side only")
    args = made.parse_args()
    folder, rows, loads = Path(tempfile.mkdtemp()), [], []
    began = time.perf_counter()
    with open_cockpit(CockpitCommand().resolved(), folder / "drive", port=8931) as cockpit:
        mark_images(cockpit)
        rows.append(("no browser", *without_browser(cockpit, args.seconds, args.presses)))
        if not args.no_browser:
            rows += in_browsers(cockpit, args.seconds, args.presses, loads)
    shutil.rmtree(folder)
    load_1, _, _ = os.getloadavg()
    there = f"The page was there after {min(loads):.1f} s. " if loads else ""
    text = (
        f"## Cockpit\n\n{' '.join((__doc__ or '').split('    python')[0].split())}\n\n"
        f"{table(HEAD, rows)}\n\n{there}Load of the machine at the end: {load_1:.1f} on "
        f"{os.cpu_count()} cores, of which this is a part; {time.perf_counter() - began:.0f} s "
        "in all."
    )
    write_section(args.out, Path(__file__), text)


@contextmanager
def watched(cockpit: Cockpit) -> Iterator[dict[str, float]]:
    """Simulated time per real time, and processor time of the server, of a block."""
    session, cpu, clock = cockpit.session, time.process_time(), time.perf_counter()
    first, found = session.view.state.time, {}  # type: ignore[union-attr]
    yield found
    passed = time.perf_counter() - clock
    found["speed"] = (session.view.state.time - first) / passed  # type: ignore[union-attr]
    found["busy"] = (time.process_time() - cpu) / passed
    found["shadows"] = not cockpit.page.images.shadows.are_left_out


def without_browser(cockpit: Cockpit, seconds: float, presses: int) -> tuple[str, ...]:
    """Server without a browser: a client in another process receives the images."""
    context = multiprocessing.get_context("spawn")
    told = context.Queue()
    given = (cockpit.gate.address, seconds, presses, told)
    process = context.Process(target=measure, args=given)
    process.start()
    windows = []
    for _ in range(2):
        assert told.get(timeout=120.0) == "begin"
        with watched(cockpit) as found:
            times = 1e3 * np.array(told.get(timeout=120.0 + seconds))
        windows.append((found, times))
    latency = 1e3 * np.array(told.get(timeout=300.0))
    process.join()
    return row(windows, latency, np.array([]), seconds)


def row(
    windows: list[tuple[dict[str, float], np.ndarray]],
    latency: np.ndarray,
    clicks: np.ndarray,
    seconds: float,
) -> tuple[str, ...]:
    """A row of the table.

    Args:
        windows: At rest and driving: result of `watched`, and times of images [ms].
        latency: Of presses [ms].
        clicks: Time from a click to its acknowledgement [ms]; empty without a browser.
        seconds: Length of a window.
    """
    speeds = [
        text
        for found, times in windows
        for text in (f"{found['speed']:.2f}", f"{len(times) / seconds:.1f}")
    ]
    found, times = windows[1]
    intervals = np.diff(times) if len(times) > 2 else np.array([np.nan])
    return (
        *speeds,
        *(f"{np.percentile(intervals, q):.0f}" for q in (10, 90)),
        *(f"{np.percentile(latency, q):.0f}" for q in (50, 90)),
        *(f"{np.percentile(clicks, q):.0f}" if len(clicks) else "–" for q in (50, 90)),
        f"{found['busy']:.2f}",
        "yes" if found["shadows"] else "left out",
    )


def in_browsers(
    cockpit: Cockpit, seconds: float, presses: int, loads: list[float]
) -> list[tuple[str, ...]]:
    """Row of each window; times [s] until the page is loaded are added to `loads`."""
    browser_path, rows = shutil.which("chromium") or shutil.which("chromium-browser"), []
    with sync_playwright() as playwright:
        for name, (size, scale) in WINDOWS.items():
            browser = playwright.chromium.launch(executable_path=browser_path, args=FLAGS)
            tab = browser.new_page(
                viewport={"width": size[0], "height": size[1]},
                device_scale_factor=scale,
                bypass_csp=True,  # the page evaluates no texts, but the conditions of waits are
            )
            tab.add_init_script(PRESSES)
            loads.append(load(tab, cockpit))
            rows.append((f"browser, {name}", *measured(tab, cockpit, seconds, presses)))
            browser.close()
    return rows


def load(tab: Page, cockpit: Cockpit) -> float:
    """Time [s] until the page's buttons exist."""
    began = time.perf_counter()
    tab.goto(cockpit.gate.address)
    tab.get_by_role("button", name="Pause").wait_for()
    taken = time.perf_counter() - began
    tab.wait_for_function(STEADY, polling=500, timeout=120_000)
    tab.evaluate(WATCH)
    return taken


def measured(tab: Page, cockpit: Cockpit, seconds: float, presses: int) -> tuple[str, ...]:
    """Speed, images and latency in a window."""
    windows = []
    for is_driving in (False, True):
        before = tab.evaluate("window.seen.images.length")
        with watched(cockpit) as found:
            for key in "da":
                if is_driving:
                    tab.keyboard.down(key)
                tab.wait_for_timeout(500.0 * seconds)
                tab.keyboard.up(key)
        windows.append((found, np.array(tab.evaluate("window.seen.images"))[before:]))
    tab.wait_for_function("!window.seen.marked.at(-1)", timeout=30_000)
    latency = [latency_of_a_press(tab, "da"[number % 2]) for number in range(presses)]
    return row(windows, np.array(latency), acknowledged(tab), seconds)


def acknowledged(tab: Page) -> np.ndarray:
    """Times from clicks to their acknowledgements [ms], as the page measures them."""
    tab.evaluate("performance.clearMeasures()")
    for _ in range(CLICKS):
        tab.get_by_role("button", name="Frame the capsule").click()
        tab.wait_for_timeout(200)
    return np.array(
        tab.evaluate("performance.getEntriesByName('acknowledgement').map((e) => e.duration)")
    )


def latency_of_a_press(tab: Page, key: str) -> float:
    """Latency from the event of a key to the first image of a state moved by it [ms]."""
    number = tab.evaluate("window.seen.images.length")
    tab.keyboard.down(key)
    tab.wait_for_function(f"window.seen.marked.slice({number}).some(Boolean)", timeout=30_000)
    tab.keyboard.up(key)
    seen: dict[str, Any] = tab.evaluate("window.seen")
    index = number + seen["marked"][number:].index(True)
    tab.wait_for_function("!window.seen.marked.at(-1)", timeout=30_000)
    return seen["images"][index] - tab.evaluate("window.pressed")


def mark_images(cockpit: Cockpit) -> None:
    """Paint a corner of the images yellow after a command that moves the magnet."""
    images, operator = cockpit.page.images, cockpit.session.operator
    make = images.image

    def marked(view: View, settings: ImageSettings, *, has_shadows: bool = True) -> LiveImage:
        picture = make(view, settings, has_shadows=has_shadows).picture.copy()
        # The page does not send an image again that has not changed.
        picture[-MARK_PX:, :MARK_PX] = 255 * (view.index % 2)
        past = [c for c in operator.commands()[1][-40:] if c.time < view.state.time]
        if past and any(past[-1].linear):
            picture[:MARK_PX, :MARK_PX] = (255, 255, 0)
        return LiveImage(settings, picture)

    images.image = marked  # type: ignore[method-assign]


if __name__ == "__main__":
    main()
