"""Patient panel: posture and insufflation."""

from __future__ import annotations

from typing import TYPE_CHECKING

from vrcaps.world.model import POSTURES

if TYPE_CHECKING:
    from vrcaps.cockpit.page import Page
    from vrcaps.cockpit.view import View


class PatientPanel:
    """Turns the patient, and inflates or empties the gut."""

    def __init__(self, page: Page) -> None:
        session = page.session
        gui = page.server.gui
        with gui.add_folder("Patient", expand_by_default=False):
            posture = gui.add_dropdown("Posture", POSTURES, initial_value=session.scenario.posture)
            turn = gui.add_button("Turn the patient")
            factor = gui.add_slider("Insufflation", 0.6, 1.6, 0.05, 1.0)
            inflate = gui.add_button("Inflate or empty")
        turn.on_click(page.for_driver(lambda: session.turn(posture.value)))
        inflate.on_click(page.for_driver(lambda: session.insufflate(float(factor.value))))

    def update(self, view: View) -> None:
        """Shows nothing: the scene does."""
