"""Patient panel: posture, insufflation, flush and phase III."""

from __future__ import annotations

from typing import TYPE_CHECKING

from vrcaps.world.model import POSTURES

if TYPE_CHECKING:
    from vrcaps.cockpit.page import Page
    from vrcaps.cockpit.view import View


class PatientPanel:
    """Controls that turn the patient, inflate or deflate the gut, rinse it, and start phase III."""

    def __init__(self, page: Page) -> None:
        session = page.session
        gui = page.server.gui
        with gui.add_folder("Patient", expand_by_default=False):
            posture = gui.add_dropdown("Posture", POSTURES, initial_value=session.scenario.posture)
            turn = gui.add_button("Turn the patient")
            factor = gui.add_slider("Insufflation", 0.6, 1.6, 0.05, 1.0)
            inflate = gui.add_button("Inflate or empty")
            flush = gui.add_button("Flush", hint="Washes off bubbles and chyme around the capsule")
            phase = gui.add_button(
                "Start phase III", hint="The strongest contractions, where the capsule is"
            )
        turn.on_click(page.for_driver(lambda: session.turn(posture.value)))
        flush.on_click(page.for_driver(session.flush))
        phase.on_click(page.for_driver(session.start_phase_three))
        inflate.on_click(page.for_driver(lambda: session.insufflate(float(factor.value))))

    def update(self, view: View) -> None:
        """Do nothing: the scene shows the patient."""
