"""A gamepad that a script moves in a real browser, and a closed loop that drives by it."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from types import SimpleNamespace
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.actuation.steering_program import workspace_above
from vrcaps.core.geometry import invert, transform_points
from vrcaps.env.actuation import MagnetActuation
from vrcaps.magnet.presets import read_magnet
from vrcaps.policy.navigator import Guide

if TYPE_CHECKING:
    from playwright.sync_api import Page

    from vrcaps.cockpit.session.clock import View
    from vrcaps.cockpit.session.session import Session

PAD = """
window.pad = {id: "Test Pad", index: 0, connected: true, mapping: "standard",
  axes: [0, 0, 0, 0], buttons: [...Array(17)].map(() => ({pressed: false, value: 0}))};
navigator.getGamepads = () => [window.pad, null, null, null];
"""
"""A gamepad as a browser would show it; runs before the page."""

DEAD_ZONE = 0.12
"""Dead zone of sticks, as in the page's program."""

_REACH = 0.2
"""Maximum distance of the magnet from the organ [m]."""

_LEAST = 0.05
"""Simulated time between looks at the page [s]: shorter ones tell no speed."""


def push(tab: Page, axes: Sequence[float]) -> None:
    """Moves sticks and triggers so that the magnet gets six axes, from −1 to 1."""
    x, y, z, tilt_x, tilt_y, turn = axes
    sticks = [_beyond_dead_zone(value) for value in (x, -y, -turn, -z)]
    pressed = {7: tilt_x, 6: -tilt_x, 5: tilt_y, 4: -tilt_y}
    buttons = {str(number): round(max(0.0, value), 3) for number, value in pressed.items()}
    tab.evaluate(
        "([axes, buttons]) => { window.pad.axes = axes;"
        " for (const [k, value] of Object.entries(buttons))"
        " window.pad.buttons[k] = {pressed: value > 0.5, value}; }",
        json.loads(json.dumps([sticks, buttons])),
    )


def _beyond_dead_zone(value: float) -> float:
    """Position of a stick that counts as a value."""
    return math.copysign(DEAD_ZONE + (1.0 - DEAD_ZONE) * abs(value), value) if value else 0.0


class PadPilot:
    """Drives by looking: at each look it takes in what the page shows, and says how to push.

    It looks at the poses of capsule and magnet and at the time, and leads as the policy
    `navigator` does.

    Attributes:
        arc_length: Place of the capsule along the gut at the last look [m].
    """

    def __init__(self, session: Session, goal: float) -> None:
        """Plans the way.

        Args:
            session: What is driven, with a first view.
            goal: Where the capsule is to go, along the centerline [m].
        """
        program, view = session.rollout.program, session.view
        assert program is not None
        assert view is not None
        steering, model = program.settings, session.rollout.model
        self._session, self._line = session, model.organ.centerline
        low, high = model.vertices_world.min(axis=0), model.vertices_world.max(axis=0)
        floor = workspace_above(model, read_magnet(steering.magnet), steering.standoff).low[2]
        box = np.array([[*(low[:2] - _REACH), floor], [*(high[:2] + _REACH), floor + _REACH]])
        self._seen = SimpleNamespace(
            patient=lambda index: SimpleNamespace(model=model),
            memory={"magnet/box": box[None], "navigate/goal": np.array([goal])},
            course=SimpleNamespace(length=np.array([self._line.length])),
            control_period=_LEAST,
            actuation=MagnetActuation(
                steering.magnet,
                speed=steering.joystick_speed,
                angular_speed=steering.joystick_angular_speed,
            ),
        )
        self.arc_length = 0.0
        self._look(view)
        self._guide = Guide(self._seen, 0)  # type: ignore[arg-type]

    def axes(self) -> np.ndarray | None:
        """Position of the sticks now; None if too little time has passed since the last look."""
        view = self._session.view
        assert view is not None
        passed = view.state.time - float(self._seen.time[0])
        if passed < _LEAST:
            return None
        self._seen.control_period = passed
        self._look(view)
        return self._guide.twist(self._seen)  # type: ignore[arg-type]

    def _look(self, view: View) -> None:
        place = invert(view.T_world_patient)
        here = transform_points(place, view.state.T_world_capsule[None, :3, 3])[0]
        nearest = int(np.argmin(((self._line.points - here) ** 2).sum(axis=1)))
        self.arc_length = float(self._line.arc_length[nearest])
        self._seen.arc_length = np.array([self.arc_length])
        self._seen.time = np.array([view.state.time])
        self._seen.T_world_capsule = view.state.T_world_capsule[None]
        self._seen.memory["magnet/T"] = view.T_world_requested[None].copy()
