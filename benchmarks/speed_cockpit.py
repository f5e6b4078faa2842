"""Claim: on two cores the cockpit shows 20 images a second at real time, 150 ms after an input.

The stomach with magnet and Panda and a camera of 320², as `vrcaps cockpit` opens it, in a headless
Chromium that draws without a graphics card, which takes much of the two cores; once with the scene
drawn in a small and once in a large window. An image counts when the browser has decoded it. For
the latency the script marks a corner of each image whose state came after a key was pressed: from
the key's event in the browser to the first marked image there.

    python benchmarks/speed_cockpit.py [--seconds 10] [--presses 12]
"""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from playwright.sync_api import Page, sync_playwright

from validation import parser, table, write_section
from vrcaps.cli.cockpit import Cockpit as CockpitCommand
from vrcaps.cockpit.camera_images import LiveImage, Look
from vrcaps.cockpit.cockpit import Cockpit, open_cockpit
from vrcaps.cockpit.view import View

FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
WINDOWS = {"small": ((900, 300), 0.2), "large": ((1400, 850), 1.0)}
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
    if (event.target.tagName === "IMG" && event.target.src.startsWith("blob:")) look(event.target);
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
"""Whether the browser draws: without a graphics card its first frames take seconds."""
PRESSES = """
const note = (event) => { if (!event.repeat) window.pressed = performance.now(); };
window.addEventListener("keydown", note, true);
"""
"""Notes the time of a key's event, before the page itself sees it."""
HEAD = (
    *("window", "speed / real time", "images a second", "p10 of intervals [ms]", "p90"),
    *("input to image [ms]: median", "p90", "processor time of the server"),
)


def main() -> None:
    """Measure, write the table."""
    made = parser(__doc__ or "")
    made.add_argument("--seconds", type=float, default=10.0, help="of each window")
    made.add_argument("--presses", type=int, default=12, help="of a key, in each window")
    args = made.parse_args()
    folder, rows = Path(tempfile.mkdtemp()), []
    scenario = CockpitCommand().resolved()
    browser_path = shutil.which("chromium") or shutil.which("chromium-browser")
    began = time.perf_counter()
    with (
        open_cockpit(scenario, folder / "drive", port=8931) as cockpit,
        sync_playwright() as playwright,
    ):
        loads = []
        for name, (size, scale) in WINDOWS.items():
            browser = playwright.chromium.launch(executable_path=browser_path, args=FLAGS)
            tab = browser.new_page(
                viewport={"width": size[0], "height": size[1]}, device_scale_factor=scale
            )
            tab.add_init_script(PRESSES)
            loads.append(load(tab, cockpit))
            rows.append((name, *measured(tab, cockpit, args.seconds, args.presses)))
            browser.close()
    shutil.rmtree(folder)
    load_1, _, _ = os.getloadavg()
    text = (
        f"## Cockpit\n\n{' '.join((__doc__ or '').split('    python')[0].split())}\n\n"
        f"{table(HEAD, rows)}\n\nThe page was there after {min(loads):.1f} s. Load of the machine "
        f"at the end: {load_1:.1f} on {os.cpu_count()} cores, of which this is a part; "
        f"{time.perf_counter() - began:.0f} s in all."
    )
    write_section(args.out, Path(__file__).name, text)


def load(tab: Page, cockpit: Cockpit) -> float:
    """Time [s] until the page's buttons are there."""
    began = time.perf_counter()
    tab.goto(cockpit.gate.address)
    tab.get_by_role("button", name="Pause").wait_for()
    taken = time.perf_counter() - began
    tab.wait_for_function(STEADY, polling=500, timeout=120_000)
    closing = "document.querySelectorAll('.mantine-Notification-closeButton')"
    tab.evaluate(f"{closing}.forEach((button) => button.click())")
    tab.evaluate(WATCH)
    return taken


def measured(tab: Page, cockpit: Cockpit, seconds: float, presses: int) -> tuple[str, ...]:
    """Speed, images and latency in a window."""
    mark_images(cockpit)
    session, cpu = cockpit.session, time.process_time()
    first, clock = session.view.state.time, time.perf_counter()  # type: ignore[union-attr]
    before = tab.evaluate("window.seen.images.length")
    tab.wait_for_timeout(1000.0 * seconds)
    passed = time.perf_counter() - clock
    speed = (session.view.state.time - first) / passed  # type: ignore[union-attr]
    times = np.array(tab.evaluate("window.seen.images"))[before:]
    busy = (time.process_time() - cpu) / passed
    intervals = np.diff(times) if len(times) > 2 else np.array([np.nan])
    latency = [latency_of_a_press(tab, "da"[number % 2]) for number in range(presses)]
    return (
        f"{speed:.2f}",
        f"{len(times) / passed:.1f}",
        *(f"{np.percentile(intervals, q):.0f}" for q in (10, 90)),
        *(f"{np.percentile(latency, q):.0f}" for q in (50, 90)),
        f"{busy:.2f}",
    )


def latency_of_a_press(tab: Page, key: str) -> float:
    """From the event of a key to the first image of a state that it has moved [ms]."""
    number = tab.evaluate("window.seen.images.length")
    tab.keyboard.down(key)
    tab.wait_for_function(f"window.seen.marked.slice({number}).some(Boolean)", timeout=30_000)
    tab.keyboard.up(key)
    seen: dict[str, Any] = tab.evaluate("window.seen")
    index = number + seen["marked"][number:].index(True)
    tab.wait_for_function("!window.seen.marked.at(-1)", timeout=30_000)
    return seen["images"][index] - tab.evaluate("window.pressed")


def mark_images(cockpit: Cockpit) -> None:
    """Paints a corner yellow of images of states after a command that moves the magnet."""
    images, operator = cockpit.page.images, cockpit.session.operator
    make = images.image

    def marked(view: View, look: Look) -> LiveImage:
        picture = make(view, look).picture.copy()
        # The page does not send an image again that has not changed.
        picture[-MARK_PX:, :MARK_PX] = 255 * (view.number % 2)
        past = [c for c in operator.commands()[1][-40:] if c.time < view.state.time]
        if past and any(past[-1].linear):
            picture[:MARK_PX, :MARK_PX] = (255, 255, 0)
        return LiveImage(look, picture)

    images.image = marked  # type: ignore[method-assign]


if __name__ == "__main__":
    main()
