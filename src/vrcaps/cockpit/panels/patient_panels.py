"""Panels of the patient: posture, insufflation, flush, phase III and the next drive."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from vrcaps.anatomy.catalog import ORGANS
from vrcaps.camera_pipeline.effect.base import MAX_SEVERITY
from vrcaps.camera_pipeline.effects import EFFECTS
from vrcaps.cockpit.session.drive import (
    CONTENTS,
    LASTING_EFFECTS,
    Choice,
    chosen_scenario,
    magnetic_capsules,
)
from vrcaps.scenario.scenario import OrganGenerated
from vrcaps.world.model import POSTURES

if TYPE_CHECKING:
    from vrcaps.cockpit.page import Page
    from vrcaps.cockpit.session.clock import View


class PatientPanel:
    """Controls that turn the patient, inflate or deflate the gut, rinse it, and start phase III."""

    def __init__(self, page: Page) -> None:
        session = page.session
        gui = page.server.gui
        with gui.add_folder("Patient", expand_by_default=False):
            posture = gui.add_dropdown("Posture", POSTURES, initial_value=session.scenario.posture)
            turn = gui.add_button("Turn the patient")
            factor = gui.add_slider("Insufflation", 0.6, 1.6, 0.05, 1.0)
            inflate = gui.add_button("Set insufflation")
            flush = gui.add_button("Flush", hint="Remove bubbles and chyme around the capsule")
            phase = gui.add_button(
                "Start phase III", hint="Start the strongest contractions, at the capsule"
            )
        turn.on_click(page.for_driver(lambda: session.turn(posture.value)))
        flush.on_click(page.for_driver(session.flush))
        phase.on_click(page.for_driver(session.start_phase_three))
        inflate.on_click(page.for_driver(lambda: session.insufflate(float(factor.value))))

    def update(self, view: View) -> None:
        """Do nothing: the scene shows the patient."""


_SAME = "unchanged"


class NewDrivePanel:
    """Controls that end the drive, which is saved, and start another one with the choices made."""

    def __init__(self, page: Page) -> None:
        self._page, self._session = page, page.session
        scenario, gui = page.session.scenario, page.server.gui
        organ = scenario.organ
        self._seed_before = organ.seed if isinstance(organ, OrganGenerated) else 0
        with gui.add_folder("New drive", expand_by_default=False):
            gui.add_markdown("The current drive is saved. All other settings stay unchanged.")
            self._organ = gui.add_dropdown("Organ", (_SAME, *ORGANS))
            self._seed = gui.add_number("Patient", self._seed_before, min=0, step=1)
            self._lesions = gui.add_text(
                "Lesions",
                "",
                hint="Such as polyp-Ip:size=12mm colitis-2, prevalence, or none; empty: unchanged",
            )
            self._capsule = gui.add_dropdown("Capsule", (_SAME, *magnetic_capsules()))
            self._file = gui.add_text("Capsule file", "", hint="A device file (TOML); empty: none")
            with gui.add_folder("Contents and camera", expand_by_default=False):
                self._sliders = {
                    name: self._slider(name, getattr(scenario.contents, name), f"Of {name}")
                    for name in CONTENTS
                } | {
                    name: self._slider(
                        name, getattr(scenario.effects, name), EFFECTS[name].summary()
                    )
                    for name in LASTING_EFFECTS
                }
            button = gui.add_button("Start a new drive")
        self._before = {name: slider.value for name, slider in self._sliders.items()}
        button.on_click(page.for_driver(self._start_drive))

    def update(self, view: View) -> None:
        """Do nothing: the drive shows the choices."""

    def _slider(self, name: str, given: Any, hint: str) -> Any:
        first = given if isinstance(given, int) else 0
        label, gui = name.replace("_", " "), self._page.server.gui
        return gui.add_slider(label, 0, MAX_SEVERITY, 1, first, hint=hint)

    def _start_drive(self) -> None:
        file = self._file.value.strip()
        if file:
            self._page.require_here("A file")
        self._page.start_drive(chosen_scenario(self._session.scenario, self._choice(file)))

    def _choice(self, file: str) -> Choice:
        """Changes made in the page; an exact value is kept until its slider is moved."""
        moved = {
            name: int(slider.value)
            for name, slider in self._sliders.items()
            if slider.value != self._before[name]
        }
        organ, capsule, seed = self._organ.value, self._capsule.value, int(self._seed.value)
        return Choice(
            organ=None if organ == _SAME else organ,
            seed=None if seed == self._seed_before else seed,
            lesions=self._lesions.value,
            capsule=file or (None if capsule == _SAME else capsule),
            contents={name: value for name, value in moved.items() if name in CONTENTS},
            effects={name: value for name, value in moved.items() if name in LASTING_EFFECTS},
        )
