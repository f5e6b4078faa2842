"""The page of a data set: frames chosen evenly, counts of the ledger, the same bytes."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest

import vrcaps
from vrcaps.cli import main
from vrcaps.core.units import MM
from vrcaps.data.store import open_store
from vrcaps.tools.reports.dataset_sample import sample


def test_frames_are_spread_over_recordings_cameras_and_time(made: Path) -> None:
    dataset = vrcaps.data.open(made)
    few, many = sample(dataset, 4), sample(dataset, 40)
    assert len(few.frames) == 4
    assert len({shot.member.patient for shot in few.frames}) == 4
    assert {shot.member.name for shot in many.frames} == {m.name for m in dataset}
    assert {shot.camera for shot in many.frames} == {"front", "rear"}
    assert {shot.frame for shot in many.frames} == {0, 1, 2}
    assert len({(s.member.name, s.camera, s.frame) for s in many.frames}) == len(many.frames)
    shot = many.frames[-1]
    depth = shot.member.read().image(shot.camera, "depth", shot.frame)
    np.testing.assert_array_equal(shot.depth, depth[np.isfinite(depth)])
    assert (shot.has_masks, shot.lesions) == (False, ())
    assert [split for split, _ in many.speeds] == [member.split for member in dataset]
    speeds = np.concatenate([speed for _, speed in many.speeds])
    assert np.all((speeds > 2 * MM) & (speeds < 20 * MM))  # the plan has 5 and 10 mm/s, ± 30 %


@pytest.mark.slow
def test_it_shows_the_counts_and_has_the_same_bytes_at_a_url(
    made: Path, tmp_path, capsys, monkeypatch
) -> None:
    main(["dataset", "show", str(made)])
    said = capsys.readouterr().out
    assert re.search(r"^all +4 +8 +24 +6 s", said, re.MULTILINE)
    assert "Lesions: none." in said
    page = made.with_name("made.html")
    text = page.read_text()
    assert "<b>48</b><span>images</span>" in text
    assert "Patients in different splits have the same organ" in text
    assert "No recording contains a lesion" in text
    # Two channels of one organ, and each of the 8 times 3 times 2 images.
    assert text.count("data:image/jpeg") == 2 + len(sample(vrcaps.data.open(made)).frames)
    assert "src='http" not in text
    pytest.importorskip("fsspec")
    store = open_store("memory://shown")
    for path in made.rglob("*"):
        if path.is_file():
            store.write(path.relative_to(made).as_posix(), path.read_bytes())
    monkeypatch.chdir(tmp_path)
    main(["dataset", "show", "memory://shown"])
    assert Path("shown.html").read_bytes() == page.read_bytes()


def test_an_empty_one_is_one_clear_line(made: Path, capsys) -> None:
    shutil.rmtree(made / "ledger")
    with pytest.raises(SystemExit):
        main(["dataset", "show", str(made)])
    assert "contains no complete recording" in capsys.readouterr().err
