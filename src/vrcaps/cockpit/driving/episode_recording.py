"""Recording of a drive as an episode while the simulation continues."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from vrcaps.core.errors import InputError, VrcapsError
from vrcaps.recording.recorder import record

if TYPE_CHECKING:
    from vrcaps.cockpit.session.drive import Drive


class EpisodeRecording:
    """Recorder of the drive so far, in a separate thread.

    Attributes:
        plain: Progress for the page: state, frames done and in total, folder, error.
    """

    def __init__(
        self, drive: Drive, is_busy: threading.Lock, on_message: Callable[[str], None]
    ) -> None:
        """Prepare.

        Args:
            drive: Drive to record.
            is_busy: Held during a recording.
            on_message: Called with messages for the user.
        """
        self._drive, self._is_busy, self._on_message = drive, is_busy, on_message
        self._number = 0
        self.plain: dict[str, Any] = {"state": "none"}

    def start(self) -> Callable[[], None]:
        """Reserve the recorder.

        Returns:
            Function that records; it blocks until the episode is complete.

        Raises:
            InputError: If a recording or the start of another drive is in progress.
        """
        if not self._is_busy.acquire(blocking=False):
            raise InputError("A recording or the start of another drive is in progress.")
        self.plain = {"state": "running", "done": 0, "total": 0}
        return self._record

    def _record(self) -> None:
        try:
            scenario = self._drive.save()
            self._number += 1
            out = self._drive.folder / f"episode-{self._number}"
            folder, total = str(out), scenario.frames
            self.plain = {"state": "running", "done": 0, "total": total, "folder": folder}
            self._on_message(f"Recording {total} frames into {out} …")
            record(scenario, out, progress=self._show)
            self.plain = self.plain | {"state": "complete", "done": total}
            self._on_message(f"Recorded {total} frames into {out}.")
        except (VrcapsError, OSError) as error:
            self.plain = self.plain | {"state": "failed", "error": str(error)}
            raise
        finally:
            if self.plain["state"] == "running":
                self.plain = self.plain | {"state": "failed", "error": "It ended early."}
            self._is_busy.release()

    def _show(self, done: int, total: int) -> None:
        self.plain = self.plain | {"done": done, "total": total}
