"""Preview video: all cameras side by side, playable in any browser."""

from __future__ import annotations

import io
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import UInt8


class Preview:
    """Video encoded in memory; the same pictures give the same bytes."""

    def __init__(
        self, *, fps: float, width: int, height: int, crf: int = 24, key_interval: int = 60
    ) -> None:
        """Start a video of pictures up to the given size.

        Args:
            fps: Frames per second.
            width: Total width of a frame's pictures [px].
            height: Height of the tallest picture [px].
            crf: Constant rate factor of VP9: 0 is best, 63 smallest.
            key_interval: Frames from one key frame to the next.
        """
        import av

        self._buffer = io.BytesIO()
        self._size = (height + height % 2, width + width % 2)  # 4:2:0 needs even sizes
        self._container = av.open(
            self._buffer, "w", format="mp4", container_options={"fflags": "+bitexact"}
        )
        rate = Fraction(fps).limit_denominator(1000)
        self._stream = self._container.add_stream("libvpx-vp9", rate=rate)
        self._stream.height, self._stream.width = self._size
        self._stream.pix_fmt = "yuv420p"
        # One thread: with more, the bytes depend on the number of threads.
        self._stream.codec_context.thread_count = 1
        self._stream.options = {
            "deadline": "realtime",
            "cpu-used": "8",
            "crf": str(crf),
            "b": "0",
            "g": str(key_interval),
            "flags": "+bitexact",
        }

    def add(self, pictures: list[UInt8[np.ndarray, "h w 3"]]) -> None:
        """Add a frame: one picture per camera, left to right."""
        import av

        canvas = np.zeros((*self._size, 3), np.uint8)
        left = 0
        for shown in pictures:
            canvas[: shown.shape[0], left : left + shown.shape[1]] = shown
            left += shown.shape[1]
        self._container.mux(self._stream.encode(av.VideoFrame.from_ndarray(canvas, format="rgb24")))

    def finish(self) -> bytes:
        """Finish encoding and return the video file."""
        self._container.mux(self._stream.encode(None))
        self._container.close()
        return self._buffer.getvalue()


def require_preview(path: Path, frames: int) -> None:
    """Check that a file is a video of this number of frames.

    Raises:
        OSError: If it cannot be read.
        ValueError: If it is not such a video.
    """
    import av
    from av.error import FFmpegError

    try:
        with av.open(str(path)) as container:
            found = container.streams.video[0].frames
    except (FFmpegError, IndexError) as error:
        raise ValueError(f"no whole video: {error}") from error
    if found != frames:
        raise ValueError(f"a video of {found} frames, not {frames}")
