"""Files of a frame: images as PNG of 8 or 16 bits or NumPy, and the wall's vertices.

Files of several frames are written while the next ones are rendered.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from threading import Thread
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps import _core
from vrcaps.camera.camera import MAX_PIXELS
from vrcaps.core.files import atomic_write, decode_array
from vrcaps.core.processes import ProgressReport
from vrcaps.organ.organ_file import split_at_seams

if TYPE_CHECKING:
    from jaxtyping import Float32
    from numpy.typing import NDArray

    from vrcaps.organ.surface import OrganSurface
    from vrcaps.world.model import Model, State

_PNG_HEADER = struct.Struct(">16xII")


def write_images(items: list[tuple[Path, NDArray]]) -> None:
    """Write images in parallel: `.png` of 8 or 16 bits, [h w] or [h w 3], and `.npy`."""
    _core.write_pngs([(str(path), array) for path, array in items if path.suffix == ".png"])
    for path, array in items:
        if path.suffix == ".npy":
            with atomic_write(path) as temporary, temporary.open("wb") as file:
                np.save(file, array, allow_pickle=False)


def read_image(path: Path) -> NDArray:
    """Stored pixel values of an image written by `write_images`.

    Raises:
        OSError: If the file cannot be read.
        ValueError: If it is not such an image.
    """
    return decode_image(path.read_bytes(), path.suffix)


def decode_image(data: bytes, suffix: str) -> NDArray:
    """Stored pixel values of an image, given the bytes of a file with this suffix.

    Raises:
        ValueError: If they are not such an image, or have more than `MAX_PIXELS`.
    """
    if suffix == ".npy":
        return decode_array(data)
    if len(data) >= _PNG_HEADER.size:
        require_pixels(*_PNG_HEADER.unpack_from(data))
    # The calling thread decodes a single image; this also works in forked processes.
    return _core.decode_pngs([np.frombuffer(data, np.uint8)])[0]


def require_pixels(width: int, height: int) -> None:
    """Check the image size declared in a header, before the pixels are decoded.

    Raises:
        ValueError: If it has no pixels, or more than `MAX_PIXELS`.
    """
    if not 0 < width * height <= MAX_PIXELS:
        raise ValueError(f"it declares {width} x {height} pixels. Allowed: 1 to {MAX_PIXELS}")


_DTYPE = "float32"


def wall_path(frame: int) -> str:
    """Path of a frame's wall in its episode."""
    return f"wall/{frame:06d}.npy"


def wall_to_plain(organ: OrganSurface) -> dict[str, Any]:
    """Storage format of walls, as in `episode.json`."""
    return {
        "meaning": "vertices of organ.glb in the world frame, in the order of the file",
        "path": "wall/{frame:06d}.npy",
        "dtype": _DTYPE,
        "unit": "m",
        "num_vertices": len(file_vertices(organ)),
    }


def file_vertices(organ: OrganSurface) -> np.ndarray:
    """Organ vertex index of each vertex of `organ.glb`, where texture seams are cut."""
    return split_at_seams(organ.faces, organ.uv)[0]


def stored_wall(model: Model, state: State, vertices: np.ndarray) -> Float32[np.ndarray, "k 3"]:
    """Wall of a state in stored form [m].

    Args:
        model: Model with the organ.
        state: State of the world.
        vertices: Result of `file_vertices`.
    """
    here = model.vertices_world if state.vertices_world is None else state.vertices_world
    return np.ascontiguousarray(here[vertices], _DTYPE)


def decode_wall(data: bytes) -> Float32[np.ndarray, "k 3"]:
    """Decode a stored wall from the bytes of its file.

    Raises:
        ValueError: If it is not such a file.
    """
    return decode_array(data)


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

    def __init__(self, progress: ProgressReport, total: int) -> None:
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
            try:
                meanwhile()
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
