"""Control of the shadows in live images: disabled while images with shadows are too slow."""

from __future__ import annotations

_ENOUGH = 20.0
"""Images per second below which shadows are disabled."""
_PLENTY = 24.0
"""Images per second expected with shadows that enable them again."""
_MEMORY = 12.0
"""Number of images over which times are averaged."""
_MAX_TIMES_LONGER = 3.0
"""Maximum ratio of the times of an image with shadows and without, by direct light. Higher ratios
are measured while the machine also starts a drive or opens a browser."""
_MIN_TIME = 2.0
"""Minimum time [s] between changes, so that images do not flicker."""


class LiveShadows:
    """Switch of the shadows in live images, by rendering time.

    Attributes:
        is_allowed: Whether shadows may be disabled.
        are_left_out: Whether the next image is rendered without shadows.
    """

    def __init__(self) -> None:
        self.is_allowed, self.are_left_out = True, False
        self._mean: float | None = None
        self._with_shadows = self._times_longer = 0.0
        self._changed = 0.0

    def note(self, seconds: float, now: float) -> None:
        """Register the time of an image.

        Args:
            seconds: Its duration, including the wait for the simulation.
            now: Monotonic time [s].
        """
        mean = seconds if self._mean is None else self._mean
        self._mean = mean = mean + (seconds - mean) / _MEMORY
        if not self.is_allowed:
            self._change(now, are_left_out=False)
        elif now - self._changed < _MIN_TIME:
            return
        elif not self.are_left_out:
            if mean > 1.0 / _ENOUGH:
                self._with_shadows, self._times_longer = mean, 0.0
                self._change(now, are_left_out=True)
        else:
            measured = min(self._with_shadows / mean, _MAX_TIMES_LONGER)
            self._times_longer = self._times_longer or measured
            if mean * self._times_longer < 1.0 / _PLENTY:
                self._change(now, are_left_out=False)

    def _change(self, now: float, *, are_left_out: bool) -> None:
        if are_left_out != self.are_left_out:
            self.are_left_out, self._changed, self._mean = are_left_out, now, None
