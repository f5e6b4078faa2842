"""Record panel: records an episode of the drive so far."""

from __future__ import annotations

from typing import TYPE_CHECKING

from vrcaps.recording.recorder import record

if TYPE_CHECKING:
    from vrcaps.cockpit.page import Page
    from vrcaps.cockpit.view import View


class RecordPanel:
    """Controls that record the drive while the simulation continues."""

    def __init__(self, page: Page) -> None:
        self._page, self._session = page, page.session
        self._number = 0
        gui = page.server.gui
        with gui.add_folder("Record", expand_by_default=False):
            folder = self._session.drive.folder
            gui.add_markdown(f"Commands are saved each second in `{folder}`.")
            button = gui.add_button("Record the drive so far")
            self._progress = gui.add_progress_bar(0.0)
        button.on_click(page.handler(lambda event: self._record()))

    def update(self, view: View) -> None:
        """Do nothing: recording reports its own progress."""

    def _record(self) -> None:
        """Record; blocks a thread of the page's library until the episode is complete."""
        if not self._page.is_busy.acquire(blocking=False):
            self._page.tell("A recording is under way, or another drive is being made.")
            return
        try:
            scenario = self._session.drive.save()
            self._number += 1
            out = self._session.drive.folder / f"episode-{self._number}"
            self._page.tell(f"Recording {scenario.frames} frames into {out} …")
            record(scenario, out, progress=self._show)
            self._page.tell(f"Recorded {scenario.frames} frames into {out}.")
        finally:
            self._page.is_busy.release()

    def _show(self, done: int, total: int) -> None:
        self._progress.value = 100.0 * done / total
