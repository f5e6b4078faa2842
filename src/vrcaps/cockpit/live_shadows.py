"""Live shadows: left out of live images while these come too slowly with them."""

from __future__ import annotations

_ENOUGH = 20.0
"""Images per second below which shadows are left out."""
_PLENTY = 24.0
"""Images per second that must be expected with shadows before they come back."""
_MEMORY = 12.0
"""Images over which times are averaged."""
_MOST_TIMES_LONGER = 3.0
"""Time of an image with shadows over that of one without, at most: that by direct light. More is
measured while the machine also begins a drive or opens a browser."""
_LEAST_TIME = 2.0
"""Shortest time [s] from one change to the next, so that images do not flicker."""


class LiveShadows:
    """Decides which live images have shadows, by the time that images take.

    Attributes:
        is_allowed: Whether shadows may be left out.
        are_left_out: Whether the next image goes without.
    """

    def __init__(self) -> None:
        self.is_allowed, self.are_left_out = True, False
        self._mean: float | None = None
        self._with_shadows = self._times_longer = 0.0
        self._changed = 0.0

    def note(self, seconds: float, now: float) -> None:
        """Takes account of an image.

        Args:
            seconds: What it took, waiting for the simulation included.
            now: Time of a steady clock [s].
        """
        mean = seconds if self._mean is None else self._mean
        self._mean = mean = mean + (seconds - mean) / _MEMORY
        if not self.is_allowed:
            self._change(now, are_left_out=False)
        elif now - self._changed < _LEAST_TIME:
            return
        elif not self.are_left_out:
            if mean > 1.0 / _ENOUGH:
                self._with_shadows, self._times_longer = mean, 0.0
                self._change(now, are_left_out=True)
        else:
            measured = min(self._with_shadows / mean, _MOST_TIMES_LONGER)
            self._times_longer = self._times_longer or measured
            if mean * self._times_longer < 1.0 / _PLENTY:
                self._change(now, are_left_out=False)

    def _change(self, now: float, *, are_left_out: bool) -> None:
        if are_left_out != self.are_left_out:
            self.are_left_out, self._changed, self._mean = are_left_out, now, None
