"""The page in a real browser: it shows the simulation and steers it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from tests.support.cockpit_browser import draw_frames, wait_until
from tests.support.pad_pilot import PAD, PadPilot, push
from tests.support.waiting import WATCHDOG
from vrcaps.cockpit.panels.scene_panels import ScenePanel
from vrcaps.core.errors import InputError
from vrcaps.core.transforms import matrix_from_quaternion, transform_points

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Locator, Page

    from vrcaps.cockpit.cockpit import Cockpit

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def tab(browser: Browser, cockpit: Cockpit) -> Iterator[Page]:
    """The page, with the first live image; the message about software rendering is closed."""
    opened = browser.new_page(viewport={"width": 1200, "height": 600}, device_scale_factor=0.5)
    opened.set_default_timeout(1e3 * WATCHDOG)
    opened.add_init_script(PAD)
    opened.goto(cockpit.gate.address)
    opened.get_by_role("button", name="Pause").wait_for()
    wait_until(opened, lambda: cockpit.page.latest_image is not None)
    closing = "document.querySelectorAll('.mantine-Notification-closeButton')"
    opened.evaluate(f"{closing}.forEach((button) => button.click())")
    draw_frames(opened)
    yield opened
    opened.close()


def field(tab: Page, label: str) -> Locator:
    """The text field after a label."""
    return tab.locator("label", has_text=label).locator("xpath=following::input[1]")


def live_image(tab: Page) -> str:
    return tab.locator("img[src^='blob:']").first.get_attribute("src") or ""


def on_screen(tab: Page, cockpit: Cockpit, point: np.ndarray) -> tuple[float, float]:
    """Position of a point of the world on the screen [px]."""
    (client,) = cockpit.page.server.get_clients().values()
    camera, box = client.camera, tab.locator("canvas").first.bounding_box()
    assert box is not None
    seen = matrix_from_quaternion(camera.wxyz).T @ (point - camera.position)
    focal = 0.5 * box["height"] / np.tan(0.5 * camera.fov)
    x, y = focal * seen[:2] / seen[2]
    return box["x"] + 0.5 * box["width"] + x, box["y"] + 0.5 * box["height"] + y


def test_dragging_the_gizmo_moves_the_magnet_and_the_image_follows(tab, cockpit):
    session = cockpit.session
    wait_until(tab, lambda: session.view.frame > 1)
    before, image = session.view.T_world_magnet[:3, 3].copy(), live_image(tab)
    handle = cockpit.page.server.scene.get_handle_by_name("/drive/magnet")
    axis = matrix_from_quaternion(np.array(handle.wxyz))[:, 2]
    start, end = (on_screen(tab, cockpit, before + reach * axis) for reach in (0.09, 0.16))
    tab.mouse.move(*start)
    draw_frames(tab)
    tab.mouse.down()
    tab.mouse.move(*(0.5 * (a + b) for a, b in zip(start, end, strict=True)))
    tab.mouse.move(*end)
    draw_frames(tab)
    tab.mouse.up()
    wait_until(tab, lambda: not session.operator.is_dragged)
    moved = session.view.T_world_requested[:3, 3] - before
    assert moved @ axis > 0.02
    assert np.linalg.norm(moved - (moved @ axis) * axis) < 0.005
    wait_until(tab, lambda: live_image(tab) != image)


def test_time_stands_while_paused_and_goes_on_by_single_frames(tab, cockpit):
    session = cockpit.session
    tab.get_by_role("button", name="Pause").click()
    tab.get_by_role("button", name="Resume").wait_for()
    stood, frame = session.view.state.time, len(session.poses)
    tab.wait_for_timeout(300)
    assert session.view.state.time == stood
    tab.get_by_role("button", name="Next frame").click()
    wait_until(tab, lambda: len(session.poses) == frame + 1)
    tab.wait_for_timeout(200)
    assert len(session.poses) == frame + 1
    tab.get_by_role("button", name="Resume").click()
    wait_until(tab, lambda: len(session.poses) > frame + 2)


def test_reset_goes_back_to_the_first_frame(tab, cockpit):
    session = cockpit.session
    first = session.poses[0]
    wait_until(tab, lambda: len(session.poses) > 3)
    tab.get_by_role("button", name="Pause").click()
    tab.get_by_role("button", name="Reset").click()
    wait_until(tab, lambda: len(session.poses) <= 1)
    tab.get_by_role("button", name="Next frame").click()
    wait_until(tab, lambda: len(session.poses) >= 1)
    np.testing.assert_array_equal(session.poses[0], first)
    tab.get_by_role("button", name="Resume").click()


def test_the_scene_shows_the_touched_wall_the_field_and_where_the_patient_lies(tab, cockpit):
    session, scene = cockpit.session, cockpit.page.server.scene
    panel = next(each for each in cockpit.page.panels if isinstance(each, ScenePanel))
    panel._color.value = "contact pressure"
    wait_until(tab, lambda: scene.get_handle_by_name("/patch/0") is not None)
    touched = scene.get_handle_by_name("/patch/0").vertices
    place = session.view.state.T_world_capsule[:3, 3]
    assert np.linalg.norm(touched - place, axis=1).max() < 0.02
    assert scene.get_handle_by_name("/capsule/body").opacity < 1.0
    panel._color.value = "segment"
    wait_until(tab, lambda: scene.get_handle_by_name("/patch/0") is None)
    assert scene.get_handle_by_name("/capsule/body").opacity is None
    lines = scene.get_handle_by_name("/magnet/field")
    assert lines.visible
    panel._has_lines.value = False
    wait_until(tab, lambda: not lines.visible)
    parts = len(scene.get_handle_by_name("/organ/1").faces)
    panel._cut_axis.value = "z"
    wait_until(tab, lambda: len(scene.get_handle_by_name("/organ/1").faces) < 0.8 * parts)
    panel._cut_axis.value = "none"
    table, outline = (scene.get_handle_by_name(name) for name in ("/table", "/patient/outline"))
    lying = transform_points(session.view.T_world_patient, outline.points.reshape(-1, 3))
    top = table.position[2] + 0.5 * table.dimensions[2]
    assert top == pytest.approx(lying[:, 2].min(), abs=1e-6)
    panel._has_patient.value = False
    wait_until(tab, lambda: not table.visible)


def test_browsers_say_how_many_frames_they_draw(tab, cockpit):
    """Without a graphics card the scene may give way; the field that says it is hidden."""
    pace = cockpit.page.pace
    wait_until(tab, lambda: len(pace._rates) > 0)
    (rate, _), *_ = pace._rates.values()
    assert 0.0 <= rate < 250.0
    fields = tab.locator("input[value^='vrcaps-frames:']")
    wait_until(tab, lambda: fields.count() == 0 or not fields.first.is_visible())


def test_a_gamepad_and_keys_steer_beyond_the_dead_zone(tab, cockpit):
    """Left stick: along x; up is −y of the stick. A pauses and goes on."""
    operator, clock = cockpit.session.operator, cockpit.session.clock

    def axes_of(stick: list[float]) -> list[float]:
        """Command of a stick at a position, as soon as it has changed."""
        number = len(operator.commands()[1])
        tab.evaluate(f"window.pad.axes = {json.dumps(stick)}")
        wait_until(tab, lambda: len(operator.commands()[1]) > number)
        last = operator.commands()[1][-1]
        return [*last.linear, *last.angular]

    assert axes_of([1.0, 0.0, 0.0, 0.0]) == [1, 0, 0, 0, 0, 0]
    assert axes_of([0.05, -0.56, 0.0, 0.0]) == [0, 0.5, 0, 0, 0, 0]
    assert axes_of([0.0, 0.0, 1.0, -1.0]) == [0, 0, 1, 0, 0, -1]
    assert axes_of([0.11, 0.0, 0.0, 0.0]) == [0, 0, 0, 0, 0, 0]
    tab.evaluate("window.pad.buttons[0].pressed = true")
    wait_until(tab, lambda: clock.is_paused)
    tab.evaluate("window.pad.buttons[0].pressed = false")
    draw_frames(tab)
    tab.evaluate("window.pad.buttons[0].pressed = true")
    wait_until(tab, lambda: not clock.is_paused)
    tab.evaluate("window.pad.buttons[0].pressed = false")
    number = len(operator.commands()[1])
    tab.keyboard.down("w")
    wait_until(tab, lambda: len(operator.commands()[1]) > number)
    assert operator.commands()[1][-1].linear == (0.0, 1.0, 0.0)
    tab.keyboard.up("w")
    wait_until(tab, lambda: operator.commands()[1][-1].linear == (0.0, 0.0, 0.0))


def test_a_pads_controls_are_assigned_by_pushing_them(tab, cockpit):
    """A pad of unknown layout drives nothing; a stick goes both ways, a trigger rests at −1."""
    operator, page = cockpit.session.operator, cockpit.page

    def last() -> tuple[float, ...]:
        command = operator.commands()[1][-1]
        return command.linear + command.angular

    def assign(control: str, axes: list[float]) -> None:
        page.bridge.ask(control)
        wait_until(tab, lambda: page.pad.listening == control)
        tab.evaluate(f"window.pad.axes = {json.dumps(axes)}")
        wait_until(tab, lambda: page.pad.listening == "" and control in page.pad.layout)
        tab.evaluate("window.pad.axes = [0, 0, 0, 0, 0, -1]")

    tab.evaluate(
        "Object.assign(window.pad, {id: 'Odd Pad', mapping: '', axes: [1, 0, 0, 0, 0, -1]})"
    )
    wait_until(tab, lambda: page.pad is not None and page.pad.pad == "Odd Pad")
    assert page.pad.layout == {}
    assert last() == (0, 0, 0, 0, 0, 0)
    tab.get_by_text("Its layout is unknown").first.wait_for()
    tab.evaluate("window.pad.axes = [0, 0, 0, 0, 0, -1]")
    draw_frames(tab)
    assign("y+", [0, 0, 0, 0.9, 0, -1])
    assign("tilt-x+", [0, 0, 0, 0, 0, 1])
    assert page.pad.layout == {"y+": "axis 3 +", "y-": "axis 3 −", "tilt-x+": "axis 5 +"}
    tab.evaluate("window.pad.axes = [0, 0, 0, -1, 0, -1]")
    wait_until(tab, lambda: last() == (0, -1, 0, 0, 0, 0))
    tab.evaluate("window.pad.axes = [0, 0, 0, 0, 0, 1]")
    wait_until(tab, lambda: last() == (0, 0, 0, 1, 0, 0))
    assert "Odd Pad" in tab.evaluate("localStorage.getItem('vrcaps-pads')")
    page.bridge.ask("standard")
    wait_until(tab, lambda: page.pad.layout.get("x+") == "axis 0 +")
    tab.evaluate("Object.assign(window.pad, {id: 'Test Pad', mapping: 'standard'})")
    tab.evaluate("window.pad.axes = [0, 0, 0, 0]")
    wait_until(tab, lambda: last() == (0, 0, 0, 0, 0, 0))


def test_a_policy_takes_over_by_a_key_and_a_stick_takes_back(tab, cockpit):
    operator = cockpit.session.operator
    tab.get_by_text("Policy", exact=True).click()
    button = tab.get_by_role("button", name="Start the policy")
    tab.get_by_role("button", name="Stop the magnet").focus()
    tab.keyboard.press("t")
    tab.get_by_role("button", name="Stop the policy").wait_for()
    assert operator.policy == "navigator"
    number = len(operator.commands()[1])
    wait_until(tab, lambda: len(operator.commands()[1]) > number)
    assert cockpit.page.driver is not None
    tab.evaluate("window.pad.axes = [1, 0, 0, 0]")
    button.wait_for()
    assert operator.policy == ""
    tab.evaluate("window.pad.axes = [0, 0, 0, 0]")
    tab.get_by_text("Policy navigator has released control").first.wait_for()


def test_a_second_browser_looks_on_and_takes_over_when_the_driver_is_gone(browser, tab, cockpit):
    operator, page = cockpit.session.operator, cockpit.page
    driver = page.driver
    other = browser.new_page(viewport={"width": 900, "height": 300}, device_scale_factor=0.3)
    other.set_default_timeout(1e3 * WATCHDOG)
    other.goto(cockpit.gate.address)
    other.get_by_role("button", name="Pause").wait_for()
    wait_until(tab, lambda: len(page.server.get_clients()) == 2)
    other.get_by_role("button", name="Pause").click()
    other.get_by_text("Another browser has control").first.wait_for()
    assert not cockpit.session.clock.is_paused
    assert page.driver == driver
    other.get_by_role("button", name="Take control").click()
    wait_until(tab, lambda: page.driver != driver)
    other.bring_to_front()
    other.keyboard.down("d")
    wait_until(other, lambda: operator.commands()[1][-1].linear == (1.0, 0.0, 0.0))
    other.close()  # in mid-drive
    wait_until(tab, lambda: page.driver == driver)
    wait_until(tab, lambda: operator.commands()[1][-1].linear == (0.0, 0.0, 0.0))
    frame = len(cockpit.session.poses)
    wait_until(tab, lambda: len(cockpit.session.poses) > frame)


def choose(tab, label: str, option: str) -> None:
    """Opens a list and takes an option; a list that closed, as the page was drawn anew, again."""
    from playwright.sync_api import TimeoutError as PlaywrightTimeout

    found = tab.get_by_role("option", name=option)
    while True:
        tab.get_by_label(label).first.click()
        try:
            found.click(timeout=10_000)
            return
        except PlaywrightTimeout:
            tab.keyboard.press("Escape")


def test_the_look_changes_and_goes_into_the_recording(tab, cockpit):
    tab.get_by_text("Rendering", exact=True).click()
    choose(tab, "Imaging", "narrow-band")
    wait_until(tab, lambda: cockpit.page.latest_image.settings.render.imaging == "narrow-band")
    assert cockpit.session.scenario_so_far().render.imaging == "narrow-band"


def test_a_scripted_gamepad_leads_the_capsule(tab, cockpit):
    """Towards the oral end, against where it looks; sticks and triggers come through exactly."""
    session, operator = cockpit.session, cockpit.session.operator
    wanted = (0.25, -0.5, 0.0, 0.75, -1.0, 0.5)
    push(tab, wanted)
    wait_until(tab, lambda: operator.commands()[1][-1].linear == wanted[:3])
    assert operator.commands()[1][-1].angular == wanted[3:]
    session.reset()
    wait_until(tab, lambda: 1 < len(session.poses) < 5)
    pilot = PadPilot(session, 0.0)
    start = pilot.arc_length

    def has_come() -> bool:
        axes = pilot.axes()
        if axes is not None:
            push(tab, axes.tolist())
        return pilot.arc_length < start - 4e-3

    wait_until(tab, has_come)
    push(tab, [0.0] * 6)


def test_another_drive_begins_in_the_same_page(tab, cockpit):
    """Not while a recording is made, nor with what cannot be; the driver stays the driver."""
    before, page = cockpit.session, cockpit.page
    driver = page.driver
    tab.get_by_text("New drive", exact=True).click()
    begin = tab.get_by_role("button", name="Start a new drive")
    with page.is_busy:
        begin.click()
        tab.get_by_text("A recording or the start of another drive").first.wait_for()
    field(tab, "Lesions").fill("wart")
    begin.click()
    tab.get_by_text("No lesion named 'wart'").first.wait_for()
    with pytest.raises(InputError, match="magnet"):
        cockpit.start_drive(replace(before.scenario, capsule="mirocam"))
    assert cockpit.session is before
    assert not (before.drive.folder / "drive-2").exists()
    field(tab, "Lesions").fill("polyp-Is:size=6mm")
    begin.click()
    wait_until(tab, lambda: cockpit.session is not before and cockpit.page.latest_image is not None)
    after = cockpit.session
    assert after.drive.folder == before.drive.folder / "drive-2"
    assert (before.drive.folder / "drive.json").is_file()
    assert [lesion.kind for lesion in after.scenario.lesions] == ["polyp"]
    assert after.scenario.render == before.scenario.render
    assert cockpit.page.driver == driver
    tab.evaluate("window.pad.axes = [0, -1, 0, 0]")
    wait_until(tab, lambda: any(c.linear == (0.0, 1.0, 0.0) for c in after.operator.commands()[1]))
    tab.evaluate("window.pad.axes = [0, 0, 0, 0]")
    image = live_image(tab)
    wait_until(tab, lambda: live_image(tab) != image)
