"""The script of the video makes one, of a few frames of each chapter."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.support.coarse_organs import COARSE
from tests.support.programs import run_program

av = pytest.importorskip("av")
ROOT = Path(__file__).parents[2]


@pytest.mark.slow
@pytest.mark.usefixtures("coarse_organs")
def test_the_quick_video_has_all_chapters(tmp_path: Path) -> None:
    script, out = ROOT / "docs" / "images" / "tour.py", tmp_path / "tour.mp4"
    result = run_program(
        script, "--quick", "--out", str(out), folder=ROOT, setup=COARSE, is_loaded=True
    )
    assert result.returncode == 0, result.stderr[-3000:]
    assert result.stdout == f"Wrote {out}: 16 frames, 8 s.\n"
    with av.open(str(out)) as video:
        shown = [frame.to_ndarray(format="rgb24") for frame in video.decode(video=0)]
    assert len(shown) == 16
    assert shown[0].shape == (540, 960, 3)
    assert all(frame[60:460].std() > 5.0 for frame in shown)  # every frame has a picture
    titles = re.findall(r'"(\d)  ', script.read_text())
    assert titles == ["1", "2", "3", "4", "5"]


def test_a_wrong_path_or_seed_is_one_line_before_the_first_chapter(tmp_path: Path) -> None:
    script, file = ROOT / "docs" / "images" / "tour.py", tmp_path / "file"
    file.write_text("")
    for given, error in (
        (("--out", str(tmp_path)), "a folder. Give a file."),
        (("--out", str(file / "tour.mp4")), "Give a file in a folder of yours."),
        (("--seed", "-1"), "--seed is -1. Allowed: 0 or more."),
    ):
        result = run_program(script, "--quick", *given, folder=tmp_path, is_loaded=True)
        assert result.returncode == 2
        assert result.stderr.splitlines()[-1].endswith(error)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
