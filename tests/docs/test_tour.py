"""The script of the video makes one, of a few frames of each chapter."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.support.coarse_organs import COARSE_BAKING
from tests.support.programs import run_program

av = pytest.importorskip("av")
ROOT = Path(__file__).parents[2]


@pytest.mark.slow
@pytest.mark.usefixtures("coarse_organs")
def test_the_quick_video_has_all_chapters(tmp_path: Path) -> None:
    script, out = ROOT / "docs" / "images" / "tour.py", tmp_path / "tour.mp4"
    result = run_program(script, "--quick", "--out", str(out), folder=ROOT, setup=COARSE_BAKING)
    assert result.returncode == 0, result.stderr[-3000:]
    assert result.stdout == f"Wrote {out}: 16 frames, 8 s.\n"
    with av.open(str(out)) as video:
        shown = [frame.to_ndarray(format="rgb24") for frame in video.decode(video=0)]
    assert len(shown) == 16
    assert shown[0].shape == (540, 960, 3)
    assert all(frame[60:460].std() > 5.0 for frame in shown)  # none is empty
    titles = re.findall(r'"(\d)  ', script.read_text())
    assert titles == ["1", "2", "3", "4", "5"]
