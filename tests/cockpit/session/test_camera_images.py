"""Live images lose their shadows while they come slowly, and get them back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.support.waiting import wait_until
from vrcaps.cockpit.session.camera_images import CameraImages, LiveShadows
from vrcaps.cockpit.session.session import Session
from vrcaps.render.renderer import Renderer


class Machine:
    """Makes images; with shadows they take twice as long."""

    def __init__(self, shadows: LiveShadows) -> None:
        self.shadows, self.now, self.changes = shadows, 100.0, 0

    def run(self, seconds_without: float, duration: float) -> None:
        end = self.now + duration
        while self.now < end:
            before = self.shadows.are_left_out
            taken = seconds_without * (1.0 if before else 2.0)
            self.now += max(taken, 1.0 / 30.0)
            self.shadows.note(taken, self.now)
            self.changes += self.shadows.are_left_out != before


def test_shadows_go_while_images_are_slow_and_come_back() -> None:
    shadows = LiveShadows()
    machine = Machine(shadows)
    machine.run(0.015, 10.0)
    assert not shadows.are_left_out
    machine.run(0.040, 10.0)
    assert shadows.are_left_out
    machine.run(0.015, 10.0)
    assert not shadows.are_left_out
    assert machine.changes == 2


def test_a_slow_start_does_not_cost_the_shadows_for_good() -> None:
    shadows = LiveShadows()
    machine = Machine(shadows)
    machine.run(0.2, 1.0)
    machine.run(0.012, 20.0)
    assert not shadows.are_left_out


@pytest.mark.parametrize("seconds", [0.021, 0.0225, 0.024, 0.026, 0.05, 0.2])
def test_images_do_not_flicker(seconds: float) -> None:
    machine = Machine(LiveShadows())
    machine.run(seconds, 60.0)
    assert machine.changes <= 1


def test_shadows_stay_where_they_may_not_be_left_out() -> None:
    shadows = LiveShadows()
    machine = Machine(shadows)
    machine.run(0.2, 5.0)
    assert shadows.are_left_out
    shadows.is_allowed = False
    machine.run(0.2, 1.0)
    assert not shadows.are_left_out
    machine.run(0.2, 10.0)
    assert machine.changes == 2


def test_an_image_without_shadows_is_that_of_a_renderer_without(drive_scenario, tmp_path) -> None:
    session = Session(drive_scenario, tmp_path / "drive")
    session.start()
    try:
        wait_until(lambda: session.view is not None)
        images, view = CameraImages(session, lambda image: None), session.view
        settings = images.settings
        for has_shadows in (True, False, True):
            found = images.image(view, settings, has_shadows=has_shadows).picture
            render_settings = replace(settings.render, shadows=has_shadows)
            renderer = Renderer(session.model, render_settings)
            expected = renderer.render(view.state, settings.camera, channels=("rgb",)).rgb
            np.testing.assert_array_equal(found, expected)
            assert (
                images._renderer[1].settings == render_settings
            )  # a straight gut throws no shadows
    finally:
        session.close()
