"""Writer of frames: files of several frames at once while the next ones are rendered."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType

_WRITERS = 4  # threads that encode and write; they mostly wait for the disk
_QUEUED_FRAMES = 6  # being written or waiting for it


class FrameWriter:
    """Runs what writes a frame beside what renders; ends when all is written.

    Files of frames are written in any order. What must follow them, such as a checkpoint, runs in
    the order of frames, when their files and those of all frames before are on the disk.

    Example:
        >>> with FrameWriter(progress, total) as writer:
        ...     writer.submit(0, show, files=write, then=note)
        ...     writer.finish()
    """

    def __init__(self, progress: Callable[[int, int], None], total: int) -> None:
        """Starts nothing yet.

        Args:
            progress: Called with the number of frames that are done and of all.
            total: Number of frames.
        """
        self._progress, self._total = progress, total
        self._pending: deque[Future[None]] = deque()
        self._is_whole = True  # whether all files so far are there
        self._writers = ThreadPoolExecutor(_WRITERS, thread_name_prefix="vrcaps-write")
        self._in_order = ThreadPoolExecutor(1, thread_name_prefix="vrcaps-order")

    def submit(
        self,
        frame: int,
        meanwhile: Callable[[], None],
        *,
        files: Callable[[], None] | None = None,
        then: Callable[[], None] | None = None,
    ) -> None:
        """Hand out the next frame; waits while many are being written.

        Args:
            frame: Its number.
            meanwhile: Runs in the order of frames, beside the writing of files.
            files: Writes its files; None where they are there.
            then: Runs in the order of frames, after its files and all before are written.

        Raises:
            OSError: If an earlier frame could not be written.
        """
        written = None if files is None else self._writers.submit(files)

        def finish() -> None:
            meanwhile()
            try:
                if written is not None:
                    written.result()
            except BaseException:
                self._is_whole = False
                raise
            if then is not None and self._is_whole:
                then()

        self._pending.append(self._in_order.submit(finish))
        while len(self._pending) > _QUEUED_FRAMES:
            self._pending.popleft().result()
        self._progress(frame + 1 - len(self._pending), self._total)

    def finish(self) -> None:
        """Wait until all frames are written.

        Raises:
            OSError: If one could not be written.
        """
        for left in range(len(self._pending) - 1, -1, -1):
            self._pending.popleft().result()
            self._progress(self._total - left, self._total)

    def __enter__(self) -> FrameWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Frames that no thread has begun are dropped; those begun are written."""
        self._writers.shutdown(wait=True, cancel_futures=True)
        self._in_order.shutdown(wait=True, cancel_futures=True)
