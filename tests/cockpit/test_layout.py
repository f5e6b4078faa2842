"""Page of a drive in a real browser, without a simulation: layout, keyboard, accessibility."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest

from tests.support.cockpit_browser import wait_until
from tests.support.still_page import StillPage, still_page
from tests.support.waiting import WATCHDOG
from vrcaps.cockpit import messages

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

pytestmark = pytest.mark.slow

SIZES = ((900, 600), (1024, 768), (1400, 800), (1920, 1080))
TABS = ("drive", "patient", "image", "scene", "new")


@pytest.fixture(scope="module")
def page() -> Iterator[StillPage]:
    """The page and its server."""
    pytest.importorskip("viser", reason="the extra cockpit is not installed")
    with still_page() as (page, gate):
        page.address = gate.address  # type: ignore[attr-defined]
        yield page


@pytest.fixture(scope="module")
def tab(browser: Browser, page: StillPage) -> Iterator[Page]:
    """The page in a browser that has seen the tour."""
    opened = browser.new_page(viewport={"width": 1400, "height": 800}, device_scale_factor=0.5)
    opened.set_default_timeout(1e3 * WATCHDOG)
    opened.faults = []  # type: ignore[attr-defined]
    opened.on("pageerror", lambda error: opened.faults.append(str(error)))  # type: ignore[attr-defined]
    opened.goto(page.address)  # type: ignore[attr-defined]
    opened.get_by_text("Step 1 of 5").wait_for()
    for step in range(2, 6):
        opened.get_by_role("button", name="Next", exact=True).click()
        opened.get_by_text(f"Step {step} of 5").wait_for()
    opened.get_by_role("button", name="Done").click()
    yield opened
    assert opened.faults == []  # type: ignore[attr-defined]
    opened.close()


@pytest.fixture(autouse=True)
def no_commands(page: StillPage) -> None:
    page.commands.clear()


def sent(page: StillPage, kind: type[messages.Command]) -> list[messages.Command]:
    return [command for command in page.commands if isinstance(command, kind)]


@pytest.mark.parametrize("size", SIZES, ids=lambda size: f"{size[0]}x{size[1]}")
def test_the_camera_image_is_the_largest_panel_and_all_are_on_the_screen(tab, size, tmp_path):
    width, height = size
    tab.set_viewport_size({"width": width, "height": height})
    tab.screenshot(path=tmp_path / f"{width}.png")
    assert tab.evaluate("document.documentElement.scrollWidth") <= width
    boxes = {
        name: tab.locator(f"#{name}").bounding_box()
        for name in ("camera-panel", "scene-panel", "map-panel", "chart-0", "chart-1", "side")
    }
    areas = {name: box["width"] * box["height"] for name, box in boxes.items()}
    assert max(areas, key=lambda name: areas[name]) == "camera-panel"
    for box in boxes.values():
        assert box["x"] >= 0
        assert box["y"] >= 0
        assert box["x"] + box["width"] <= width
        assert box["y"] + box["height"] <= height
        assert min(box["width"], box["height"]) > 90
    image = tab.locator("#camera-image").bounding_box()
    assert image["width"] * image["height"] > 0.98 * areas["camera-panel"]
    tab.set_viewport_size({"width": 1400, "height": 800})


def test_an_accessibility_checker_finds_nothing(tab):
    """axe-core: names, labels, roles, contrast; the scene is a page of another library."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright").Axe()
    for name in TABS:
        tab.locator(f"#tab-{name}").click()
        found = axe.run(tab, options={"iframes": False}).response["violations"]
        assert [(each["id"], each["nodes"][0]["html"]) for each in found] == []
    tab.locator("#tab-drive").click()


def test_a_click_shows_at_once_and_is_acknowledged(tab, page):
    """The button changes in the click itself; the acknowledgement is measured by the page."""
    tab.evaluate("performance.clearMeasures()")
    during = tab.evaluate(
        "() => { const button = document.querySelector('#pause'); button.click();"
        " return [button.className, button.getAttribute('aria-label')]; }"
    )
    assert during == ["icon sent", "Resume"]
    wait_until(tab, lambda: tab.locator("#pause").get_attribute("class") == "icon")
    assert sent(page, messages.Pause)
    measured = "performance.getEntriesByName('acknowledgement').map((each) => each.duration)"
    assert len(tab.evaluate(measured)) == 1


def test_what_destroys_is_confirmed_and_what_has_no_object_is_disabled(tab, page):
    for name in ("rewind", "stop-magnet", "flush", "pad-assign"):
        assert tab.locator(f"#{name}").is_disabled()
    page.values["snapshots"] = ["1.20 s"]
    tab.locator("#rewind:enabled").wait_for()
    for answer, count in (("Cancel", 0), ("Reset", 1)):
        tab.locator("#reset").click()
        tab.get_by_role("dialog").get_by_role("button", name=answer).click()
        tab.get_by_role("dialog").wait_for(state="hidden")
        if count:
            wait_until(tab, lambda: sent(page, messages.Reset))
        assert len(sent(page, messages.Reset)) == count
    page.values["driver"] = 7
    tab.get_by_role("button", name="Take control").wait_for()
    for name in ("pause", "record", "rewind", "policy"):
        assert tab.locator(f"#{name}").is_disabled()
    page.values["driver"] = 1
    tab.locator("#pause:enabled").wait_for()


def test_keys_drive_unless_one_types(tab, page):
    tab.locator("#side").focus()
    tab.keyboard.down("d")
    wait_until(tab, lambda: sent(page, messages.Steer))
    assert sent(page, messages.Steer)[0].axes[0] == 1.0
    tab.keyboard.up("d")
    wait_until(tab, lambda: not any(sent(page, messages.Steer)[-1].axes))
    tab.locator("#tab-new").click()
    tab.get_by_label("Lesions").focus()
    number = len(page.commands)
    tab.keyboard.type("wads pnbt")
    tab.wait_for_timeout(300)
    assert all(isinstance(each, messages.ReportFrameRate) for each in page.commands[number:])
    tab.get_by_label("Lesions").fill("")
    tab.locator("#tab-drive").click()
    tab.keyboard.press("n")
    wait_until(tab, lambda: sent(page, messages.StepFrame))


def test_keys_on_the_image_drive_by_touch_and_are_named_by_the_patients_directions(tab, page):
    key = tab.get_by_role("button", name="D: Move to +x (patient's left)")
    key.wait_for()
    key.hover()
    tab.mouse.down()
    wait_until(tab, lambda: any(each.axes[0] == 1.0 for each in sent(page, messages.Steer)))
    tab.mouse.up()
    wait_until(tab, lambda: not any(sent(page, messages.Steer)[-1].axes))


def test_the_keyboard_alone_reaches_everything(tab):
    """One tab stop per group of buttons, arrows within it; the focus can be seen."""
    tab.locator("#pause").focus()
    tab.keyboard.press("ArrowRight")
    assert tab.evaluate("document.activeElement.id") == "step"
    assert tab.evaluate("getComputedStyle(document.activeElement).outlineStyle") == "solid"
    found = []
    for _ in range(40):
        tab.keyboard.press("Tab")
        found.append(tab.evaluate("document.activeElement.id"))
        if found[-1] == "snapshot":
            break
    wanted = ["speed", "record", "help", "camera", "channel", "frame-capsule", "frame-all"]
    wanted += ["chart-0-quantity", "chart-1-quantity", "tab-drive", "policy", "goal"]
    assert [name for name in found if name in wanted] == wanted
    tab.locator("#tab-drive").focus()
    tab.keyboard.press("End")
    assert tab.locator("#pane-new").is_visible()
    tab.keyboard.press("Home")
    assert tab.locator("#pane-drive").is_visible()


def test_an_error_of_the_next_drive_is_at_its_field(tab, page):
    tab.locator("#tab-new").click()
    tab.get_by_label("Lesions").fill("wart")
    tab.get_by_role("button", name="Start a new drive").click()
    tab.get_by_role("dialog").get_by_role("button", name="Start a new drive").click()
    tab.get_by_text("No lesion named 'wart'").wait_for()
    field = tab.get_by_label("Lesions")
    assert field.get_attribute("aria-invalid") == "true"
    assert field.get_attribute("aria-describedby") == "new-error"
    assert field.evaluate("(node) => node === document.activeElement")
    tab.get_by_label("Seed").fill("-4")
    assert field.get_attribute("aria-invalid") is None
    tab.get_by_role("button", name="Start a new drive").click()
    tab.get_by_text("Seed is -4. Allowed").wait_for()
    assert not sent(page, messages.NewDrive)
    tab.get_by_label("Seed").fill("0")
    tab.get_by_label("Lesions").fill("")
    tab.locator("#tab-drive").click()


def test_a_recording_counts_its_frames_and_names_its_episode(tab, page):
    page.values["recording"] = {"state": "running", "done": 3, "total": 12, "folder": "runs/e"}
    tab.get_by_text("Recording frame 3 of 12").wait_for()
    assert tab.locator("#recording-progress").get_attribute("value") == "3"
    page.values["recording"] = {"state": "complete", "done": 12, "total": 12, "folder": "runs/e"}
    tab.get_by_text("Episode recorded: 12 of 12 frames").wait_for()
    assert tab.locator("#recording-path").text_content() == "runs/e"
    tab.get_by_role("button", name="Copy the command to view it").wait_for()
    tab.locator("#recording-close").click()


def test_charts_do_not_blow_up_noise(tab):
    """The axis of noise of 1e-3 mN around 20 mN spans 20 mN, with readable ticks."""
    axis = tab.evaluate("import('/chart.js').then((m) => m.axisOf([19.999, 20.001], 20))")
    assert (axis["low"], axis["high"], axis["ticks"]) == (10, 30, [10, 15, 20, 25, 30])
    axis = tab.evaluate("import('/chart.js').then((m) => m.axisOf([0.2, 0.21], 5))")
    assert axis["low"] == 0
    assert axis["high"] >= 5
    axis = tab.evaluate("import('/chart.js').then((m) => m.axisOf([null, NaN], 5))")
    assert (axis["low"], axis["high"]) == (0, 6)
    ticks = "import('/chart.js').then((m) => [m.formatTick(0.25, 0.05), m.formatTick(120, 20)])"
    assert tab.evaluate(ticks) == ["0.25", "120"]


def test_the_tour_can_be_skipped_and_shown_again(tab):
    tab.keyboard.press("h")
    tab.get_by_text("Step 1 of 5").wait_for()
    tab.get_by_role("button", name="Skip").click()
    tab.get_by_text("Step 1 of 5").wait_for(state="hidden")
    tab.reload()
    tab.locator("#driver").get_by_text("drives").wait_for()
    assert not tab.locator("#tour").is_visible()
