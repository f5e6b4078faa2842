"""Policy panel: a policy or baseline that takes over and hands back."""

from __future__ import annotations

from typing import TYPE_CHECKING

from vrcaps.cockpit.policy_driver import PolicyDriver
from vrcaps.core.errors import UnknownNameError
from vrcaps.env.actuation.magnet import MagnetActuation
from vrcaps.policy.policy import policy_names

if TYPE_CHECKING:
    from vrcaps.cockpit.page import Page
    from vrcaps.cockpit.view import View

_TAKE, _BACK = "Let the policy drive", "Take the magnet back"
_FIRST = "navigator"
"""Preselected policy: it navigates to a position."""


class PolicyPanel:
    """Choice of the driving policy."""

    def __init__(self, page: Page) -> None:
        self._page, self._session, self._shown = page, page.session, ""
        gui = page.server.gui
        with gui.add_folder("Policy", expand_by_default=False):
            names = (*policy_names(MagnetActuation.kind), *page.policies)
            self._names = tuple(dict.fromkeys(names))
            self._name = gui.add_dropdown("Policy", self._names, initial_value=_FIRST)
            self._goal = gui.add_slider(
                "Goal", 0.0, 1.0, 0.01, 1.0, hint="Where navigate leads, from the oral end"
            )
            self._button = gui.add_button(_TAKE, hint="Key T, pad Y; any other input takes back")
        page.actions["policy"] = page.handler(self._toggle)
        self._button.on_click(page.for_driver(self._toggle))
        gui.add_command(_TAKE, hotkey="T").on_trigger(page.for_driver(self._toggle))

    def update(self, view: View) -> None:
        """Report when a policy has started or has handed back."""
        drives = self._session.operator.policy
        if drives == self._shown:
            return
        self._page.tell(f"{drives} drives." if drives else f"{self._shown} has handed back.")
        self._shown = drives
        self._button.label = _BACK if drives else _TAKE

    def _toggle(self) -> None:
        operator, session = self._session.operator, self._session
        if operator.policy:
            operator.stop()
            return
        name = self._name.value
        if name not in self._names:  # a browser may send any text, and a policy may run any code
            raise UnknownNameError("policy", name, self._names)
        driver = PolicyDriver(
            name,
            session.rollout,
            posture=session.scenario.posture,
            seed=session.scenario.seed,
            goal=float(self._goal.value),
            on_message=self._page.tell,
        )
        operator.hand_over(driver)
