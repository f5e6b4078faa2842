"""Concurrent frame writer: files of several frames are written while the next ones are rendered."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from threading import Thread
from types import TracebackType

_WRITERS = 4  # threads that encode and write; they mostly wait for the disk
_QUEUED_FRAMES = 6  # frames being written or waiting


class FrameWriter:
    """Write frames in parallel with rendering; `finish` waits for all of them.

    Files of frames are written in any order. Callbacks that must follow them, such as a
    checkpoint, run in frame order, after the files of this and all earlier frames are on disk.

    Example:
        >>> with FrameWriter(progress, total) as writer:
        ...     writer.submit(0, show, files=write, then=note)
        ...     writer.finish()
    """

    def __init__(self, progress: Callable[[int, int], None], total: int) -> None:
        """Initialize; no thread starts yet.

        Args:
            progress: Called with the number of finished frames and the total.
            total: Number of frames.
        """
        self._progress, self._total = progress, total
        self._pending: deque[Future[None]] = deque()
        self._is_whole = True  # whether all files so far exist
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
        """Submit the next frame; blocks while many are being written.

        Args:
            frame: Index of the frame.
            meanwhile: Runs in frame order, in parallel with the writing of files.
            files: Writes its files; None if they exist.
            then: Runs in frame order, after its files and all earlier ones are written.

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
        """Drop frames that no thread has started; finish those that have been started."""
        self._writers.shutdown(wait=True, cancel_futures=True)
        self._in_order.shutdown(wait=True, cancel_futures=True)


class Background:
    """Work in a thread that runs while the frames are rendered, after the first of them.

    The compression of textures takes longer than the first frames, and needs one core, which would
    delay the first picture. The thread is a daemon, so that an error or an interruption of the
    recording does not wait for it.
    """

    def __init__(self, work: Callable[[], None]) -> None:
        self._error: BaseException | None = None
        self._thread = Thread(target=self._run, args=(work,), daemon=True)
        self._is_started = False

    def start(self) -> None:
        """Start the work if it has not been started."""
        if not self._is_started:
            self._is_started = True
            self._thread.start()

    def _run(self, work: Callable[[], None]) -> None:
        try:
            work()
        except BaseException as error:
            self._error = error

    def wait(self) -> None:
        """Wait until the work is done, and raise its error if it failed."""
        self.start()
        self._thread.join()
        if self._error is not None:
            raise self._error
