"""The page in a real browser: it shows the simulation and steers it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from tests.support.cockpit_browser import draw_frames, wait_until
from tests.support.pad_pilot import PAD, PadPilot, push
from tests.support.waiting import WATCHDOG
from vrcaps.cockpit.scene.viewpoint import scene_clients
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import matrix_from_quaternion, transform_points
from vrcaps.recording.episode import read_episode

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

    from vrcaps.cockpit.cockpit import Cockpit

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def tab(browser: Browser, cockpit: Cockpit) -> Iterator[Page]:
    """The page, with the first live image and the scene."""
    opened = browser.new_page(viewport={"width": 1300, "height": 700}, device_scale_factor=0.5)
    opened.set_default_timeout(1e3 * WATCHDOG)
    opened.add_init_script(PAD)
    opened.add_init_script("localStorage.setItem('vrcaps-tour', 'seen')")
    opened.goto(cockpit.gate.address)
    opened.get_by_role("button", name="Pause").wait_for()
    wait_until(opened, lambda: cockpit.page.latest_image is not None)
    wait_until(opened, lambda: scene_clients(cockpit.page.server))
    draw_frames(opened)
    yield opened
    opened.close()


def live_image(tab: Page) -> str:
    return tab.locator("#camera-image").get_attribute("src") or ""


def choose_scene(tab: Page, label: str, option: str) -> None:
    """Choose an option of the display of the scene."""
    tab.locator("#tab-scene").click()
    tab.get_by_label(label, exact=True).select_option(option)


def confirm(tab: Page, answer: str) -> None:
    tab.get_by_role("dialog").get_by_role("button", name=answer).click()


def on_screen(tab: Page, cockpit: Cockpit, point: np.ndarray) -> tuple[float, float]:
    """Position of a point of the world on the screen [px]."""
    (client,) = scene_clients(cockpit.page.server).values()
    camera, box = client.camera, tab.locator("#scene").bounding_box()
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
    tab.get_by_role("button", name="Reset to the first frame").click()
    confirm(tab, "Reset")
    wait_until(tab, lambda: len(session.poses) <= 1)
    tab.get_by_role("button", name="Next frame").click()
    wait_until(tab, lambda: len(session.poses) >= 1)
    np.testing.assert_array_equal(session.poses[0], first)
    tab.get_by_role("button", name="Resume").click()


def test_the_scene_shows_the_touched_wall_the_field_and_where_the_patient_lies(tab, cockpit):
    session, scene = cockpit.session, cockpit.page.server.scene
    choose_scene(tab, "Color by", "contact pressure")
    wait_until(tab, lambda: scene.get_handle_by_name("/patch/0") is not None)
    touched = scene.get_handle_by_name("/patch/0").vertices
    place = session.view.state.T_world_capsule[:3, 3]
    assert np.linalg.norm(touched - place, axis=1).max() < 0.02
    assert scene.get_handle_by_name("/capsule/body").opacity < 1.0
    tab.get_by_text("below 0.5 kPa").wait_for()
    choose_scene(tab, "Color by", "segment")
    wait_until(tab, lambda: scene.get_handle_by_name("/patch/0") is None)
    assert scene.get_handle_by_name("/capsule/body").opacity is None
    lines = scene.get_handle_by_name("/magnet/field")
    assert lines.visible
    tab.get_by_label("Field lines of the magnet").uncheck()
    wait_until(tab, lambda: not lines.visible)
    cut = len(scene.get_handle_by_name("/organ/1").faces)
    choose_scene(tab, "Cut", "none")
    wait_until(tab, lambda: len(scene.get_handle_by_name("/organ/1").faces) > 1.2 * cut)
    table, outline = (scene.get_handle_by_name(name) for name in ("/table", "/patient/outline"))
    lying = transform_points(session.view.T_world_patient, outline.points.reshape(-1, 3))
    top = table.position[2] + 0.5 * table.dimensions[2]
    assert top == pytest.approx(lying[:, 2].min(), abs=1e-6)
    tab.get_by_label("Patient and table").uncheck()
    wait_until(tab, lambda: not table.visible)


def test_the_viewpoint_frames_the_capsule_and_its_scale_is_true(tab, cockpit):
    """The panels of the scene's library are hidden; the frame rate is reported."""
    (client,) = scene_clients(cockpit.page.server).values()
    tab.get_by_role("button", name="Frame the capsule").click()
    place = cockpit.session.view.state.T_world_capsule[:3, 3]
    wait_until(tab, lambda: np.linalg.norm(client.camera.look_at - place) < 0.01)
    size = np.ptp(cockpit.page.box("capsule"), axis=0).max()
    height = 2.0 * np.tan(0.5 * client.camera.fov)
    height *= np.linalg.norm(client.camera.position - client.camera.look_at)
    assert 1.0 < height / size < 3.0
    bar, frame = tab.locator("#scale-bar"), tab.locator("#scene").bounding_box()

    def true_width() -> object:
        size = 0.01 * float(tab.locator("#scale-text").text_content().split()[0])
        return pytest.approx(size / height * frame["height"], rel=0.1)

    # The page shows the scale of an earlier viewpoint until the camera has arrived.
    wait_until(tab, lambda: bar.bounding_box()["width"] == true_width())
    assert tab.locator("#scale-text").text_content() in ("1 cm", "2 cm", "5 cm")
    panels = tab.frame_locator("#scene").locator("button:visible")
    assert panels.count() == 0
    wait_until(tab, lambda: len(cockpit.page.scene.pace._rates) > 0)


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
    operator = cockpit.session.operator

    def last() -> tuple[float, ...]:
        command = operator.commands()[1][-1]
        return command.linear + command.angular

    def assign(control: str, axes: list[float], shown: str) -> None:
        tab.get_by_label("Function").select_option(control)
        tab.get_by_role("button", name="Assign").click()
        tab.get_by_text("Move the stick or press the button").wait_for()
        tab.evaluate(f"window.pad.axes = {json.dumps(axes)}")
        tab.locator("#pad-table").get_by_text(shown).wait_for()
        tab.evaluate("window.pad.axes = [0, 0, 0, 0, 0, -1]")

    tab.locator("#tab-drive").click()
    tab.locator("#pad-details summary").click()
    tab.evaluate(
        "Object.assign(window.pad, {id: 'Odd Pad', mapping: '', axes: [1, 0, 0, 0, 0, -1]})"
    )
    tab.get_by_text("Its layout is unknown").wait_for()
    assert last() == (0, 0, 0, 0, 0, 0)
    tab.evaluate("window.pad.axes = [0, 0, 0, 0, 0, -1]")
    draw_frames(tab)
    assign("y+", [0, 0, 0, 0.9, 0, -1], "axis 3 −")
    assign("tilt-x+", [0, 0, 0, 0, 0, 1], "axis 5 +")
    draw_frames(tab)
    tab.evaluate("window.pad.axes = [0, 0, 0, -1, 0, -1]")
    wait_until(tab, lambda: last() == (0, -1, 0, 0, 0, 0))
    tab.evaluate("window.pad.axes = [0, 0, 0, 0, 0, 1]")
    wait_until(tab, lambda: last() == (0, 0, 0, 1, 0, 0))
    assert "Odd Pad" in tab.evaluate("localStorage.getItem('vrcaps-pads')")
    tab.get_by_role("button", name="Standard layout").click()
    tab.locator("#pad-table").get_by_text("axis 0 +").wait_for()
    tab.evaluate("Object.assign(window.pad, {id: 'Test Pad', mapping: 'standard'})")
    tab.evaluate("window.pad.axes = [0, 0, 0, 0]")
    wait_until(tab, lambda: last() == (0, 0, 0, 0, 0, 0))
    tab.locator("#pad-details summary").click()


def test_a_policy_takes_over_by_a_key_and_a_stick_takes_back(tab, cockpit):
    operator = cockpit.session.operator
    tab.locator("#side").focus()
    tab.keyboard.press("t")
    tab.get_by_text("Policy navigator drives").wait_for()
    assert operator.policy == "navigator"
    number = len(operator.commands()[1])
    wait_until(tab, lambda: len(operator.commands()[1]) > number)
    tab.evaluate("window.pad.axes = [1, 0, 0, 0]")
    tab.get_by_role("button", name="Start the policy").wait_for()
    assert operator.policy == ""
    tab.evaluate("window.pad.axes = [0, 0, 0, 0]")
    tab.get_by_text("Policy navigator has released control").first.wait_for()


def test_a_second_browser_looks_on_and_takes_over_when_the_driver_is_gone(browser, tab, cockpit):
    operator, page = cockpit.session.operator, cockpit.page
    driver = page.driver
    other = browser.new_page(viewport={"width": 900, "height": 600}, device_scale_factor=0.3)
    other.set_default_timeout(1e3 * WATCHDOG)
    other.add_init_script("localStorage.setItem('vrcaps-tour', 'seen')")
    other.goto(cockpit.gate.address)
    other.get_by_text(f"Browser {driver} drives").wait_for()
    assert other.get_by_role("button", name="Pause").is_disabled()
    assert page.driver == driver
    other.get_by_role("button", name="Take control").click()
    wait_until(tab, lambda: page.driver != driver)
    other.get_by_text("You drive").wait_for()
    other.bring_to_front()
    other.keyboard.down("d")
    wait_until(other, lambda: operator.commands()[1][-1].linear == (1.0, 0.0, 0.0))
    other.close()  # in mid-drive
    wait_until(tab, lambda: page.driver == driver)
    wait_until(tab, lambda: operator.commands()[1][-1].linear == (0.0, 0.0, 0.0))
    frame = len(cockpit.session.poses)
    wait_until(tab, lambda: len(cockpit.session.poses) > frame)


def test_the_look_changes_and_goes_into_the_recording(tab, cockpit):
    tab.locator("#tab-image").click()
    tab.get_by_label("Imaging").select_option("narrow-band")
    wait_until(tab, lambda: cockpit.page.latest_image.settings.render.imaging == "narrow-band")
    assert cockpit.session.scenario_so_far().render.imaging == "narrow-band"
    tab.get_by_label("Channel", exact=True).select_option("depth")
    wait_until(tab, lambda: cockpit.page.latest_image.settings.channel == "depth")
    tab.get_by_label("Channel", exact=True).select_option("rgb")


def test_an_episode_is_recorded_while_the_drive_goes_on(tab, cockpit):
    session = cockpit.session
    session.reset()
    wait_until(tab, lambda: 1 < len(session.poses) < 5)
    tab.get_by_role("button", name="Record episode").click()
    tab.get_by_text("Episode recorded:").wait_for()
    folder = Path(tab.locator("#recording-path").text_content() or "")
    assert read_episode(folder).scenario.organ == session.scenario.organ
    tab.locator("#recording-close").click()


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
    tab.locator("#tab-new").click()
    begin = tab.get_by_role("button", name="Start a new drive")
    with page._is_busy:
        wait_until(tab, begin.is_disabled)
        with pytest.raises(InputError, match="in progress"):
            cockpit.start_drive(before.scenario)
    tab.get_by_label("Lesions").fill("wart")
    begin.click()
    confirm(tab, "Start a new drive")
    tab.get_by_text("No lesion named 'wart'").first.wait_for()
    with pytest.raises(InputError, match="magnet"):
        cockpit.start_drive(replace(before.scenario, capsule="mirocam"))
    assert cockpit.session is before
    assert not (before.drive.folder / "drive-2").exists()
    tab.get_by_label("Lesions").fill("polyp-Is:size=6mm")
    begin.click()
    confirm(tab, "Start a new drive")
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
