"""The writer of frames: all at once, in order where it matters, nothing after what failed."""

import threading
import time

import pytest

from vrcaps.recording.frame_files import FrameWriter


def test_what_follows_waits_for_all_files_before_it() -> None:
    """Files of later frames may come first; what follows them comes in the order of frames."""
    written, followed, shown, told = [], [], [], []
    late = threading.Event()

    def write(frame: int) -> None:
        if frame == 0:
            late.wait(5.0)
        written.append(frame)
        if frame == 2:
            late.set()

    with FrameWriter(lambda done, total: told.append((done, total)), 4) as writer:
        for frame in range(4):
            writer.submit(
                frame,
                lambda frame=frame: shown.append(frame),
                files=lambda frame=frame: write(frame),
                then=lambda frame=frame: followed.append((frame, set(written))),
            )
        writer.finish()
    assert written.index(2) < written.index(0)
    assert [frame for frame, _ in followed] == shown == [0, 1, 2, 3]
    assert all(set(range(frame + 1)) <= there for frame, there in followed)
    assert told[-1] == (4, 4)


@pytest.mark.parametrize("is_shown", [True, False])
def test_nothing_follows_a_frame_that_could_not_be_written_or_shown(is_shown: bool) -> None:
    followed = []

    def fail() -> None:
        raise OSError(28, "No space left on device")

    def good() -> None:
        pass

    def run() -> None:
        with FrameWriter(lambda *_: None, 2) as writer:
            show, write = (good, fail) if is_shown else (fail, good)
            writer.submit(0, show, files=write, then=lambda: followed.append(0))
            writer.submit(1, lambda: None, files=lambda: None, then=lambda: followed.append(1))
            time.sleep(0.02)
            writer.finish()

    with pytest.raises(OSError, match="No space left"):
        run()
    assert followed == []
