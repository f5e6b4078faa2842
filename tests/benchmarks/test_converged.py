"""Converged networks in the training source and another one: statistics, baseline, a whole run."""

import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks.common.sources import ROOT
from benchmarks.sim_to_real import converged
from benchmarks.sim_to_real.cells import ROWS, Cell, Row
from benchmarks.sim_to_real.converged import (
    DISC,
    OURS,
    TASK,
    cells_of,
    convergence,
    difference_text,
    disc_dice,
    page_text,
)
from benchmarks.sim_to_real.images import Pictures
from benchmarks.sim_to_real.setup import frames_of
from benchmarks.sim_to_real.statistics import same_images_interval
from tests.support.real_folders import write_real
from vrcaps.core.errors import InputError
from vrcaps.learn.networks import Backbone
from vrcaps.learn.samples import Samples
from vrcaps.learn.settings import IMAGENET
from vrcaps.learn.tasks.segmentation import SegmentationTask

WEIGHTS = ROOT / "weights" / "segmentation.safetensors"


def row(arm: str, seed: int, home: float, other: float, curve: tuple[float, ...] = ()) -> Row:
    """Row of one network with the same metric on all images of a source."""
    values = {
        "home": [home] * 6,
        "other": [other] * 4,
        "other_groups": [0, 0, 1, 2],
        "curve": list(curve),
        "every": [100],
    }
    fraction = 0.1 if arm != DISC else 0.0
    return Row(Cell(TASK, arm, fraction, seed), {"basis": "a", "first": ""}, values, [*range(6)], 1)


def test_images_that_all_seeds_share_do_not_count_once_per_seed() -> None:
    """With equal values of ten seeds, Var = within / n, as for one seed."""
    values = np.random.default_rng(0).standard_normal(200)
    interval = same_images_interval(np.repeat(values[None], 10, axis=0), np.arange(200))
    spread = values.std() / np.sqrt(200)
    assert (interval.high - interval.low) / (2 * 1.96) == pytest.approx(spread, rel=0.1)
    assert interval.value == pytest.approx(values.mean())


def test_variation_between_seeds_is_in_the_interval() -> None:
    centers = np.random.default_rng(1).standard_normal(40)
    interval = same_images_interval(np.repeat(centers[:, None], 50, axis=1), np.arange(50))
    spread = centers.std() / np.sqrt(40)
    assert (interval.high - interval.low) / (2 * 1.96) == pytest.approx(spread, rel=0.1)


def test_images_of_one_group_are_drawn_together() -> None:
    values = np.random.default_rng(2).standard_normal((2, 40))
    alone = same_images_interval(values, np.arange(40))
    tenfold = same_images_interval(np.repeat(values, 10, axis=1), np.repeat(np.arange(40), 10))
    assert (tenfold.low, tenfold.high) == pytest.approx((alone.low, alone.high))


def test_convergence_is_the_first_evaluation_near_the_best() -> None:
    assert convergence(row(IMAGENET, 0, 0.5, 0.5, (0.2, 0.77, 0.8, 0.79))) == 200
    assert convergence(row(IMAGENET, 0, 0.5, 0.5, (0.2, 0.7, 0.8, 0.79))) == 300


def test_differences_are_over_common_seeds_in_points() -> None:
    rows = [row(IMAGENET, seed, 0.6 + seed / 10.0, 0.4) for seed in range(3)]
    rows += [row(OURS, seed, 0.61 + seed / 10.0, 0.46) for seed in range(2)]
    home, other, seeds = difference_text(converged.arms_of(rows), OURS, 0.1)
    assert (home, other, seeds) == ("+1.0 [+1.0, +1.0]", "+6.0 [+6.0, +6.0]", "2")
    text = page_text([*rows, row(DISC, 0, 0.4, 0.2)])
    assert "| 10 % | ImageNet + ours | +1.0 [+1.0, +1.0] | +6.0 [+6.0, +6.0] | 2 |" in text
    assert "| 0 % | centered disc | 40.0 [40.0, 40.0] | 20.0 [20.0, 20.0] |" in text


def test_rows_of_other_settings_are_left_out() -> None:
    old = row(IMAGENET, 0, 0.1, 0.1)
    old.made_of["basis"] = "b"
    other = row(OURS, 0, 0.1, 0.1)
    other.made_of["first"] = "weights of another training"
    found = converged.arms_of([old, other, row(OURS, 1, 0.6, 0.4), row(IMAGENET, 1, 0.6, 0.4)])
    assert [*found[IMAGENET, 0.1]] == [*found[OURS, 0.1]] == [1]


def test_averaged_networks_are_an_arm_of_their_own() -> None:
    ours = row(OURS, 0, 0.6, 0.4)
    ours.values["averaged_home"], ours.values["averaged_other"] = [0.58] * 6, [0.47] * 4
    text = page_text([ours, row(IMAGENET, 0, 0.55, 0.4), row(OURS, 1, 0.6, 0.4)])
    assert text.startswith("## Converged") and "\n\n3 networks and baselines" in text
    assert (
        "| 10 % | ImageNet + ours, averaged | +3.0 [+3.0, +3.0] | +7.0 [+7.0, +7.0] | 1 |" in text
    )
    assert "| 10 % | ImageNet + ours | +5.0 [+5.0, +5.0] | +0.0 [+0.0, +0.0] | 1 |" in text


def test_a_centered_disc_has_dice_one_on_centered_discs() -> None:
    side, radius = 60, 0.3
    distance = np.hypot(*(np.indices((side, side)) - 0.5 * (side - 1))) / side
    masks = [(distance <= radius).astype(np.uint8)] * 3 + [(distance <= 0.1).astype(np.uint8)]
    images = [np.full((side, side, 3), 90, np.uint8)] * 4
    task = SegmentationTask(classes=("polyp",), backbone=Backbone(64))
    pictures = Pictures("discs", images, masks=masks, kinds=("polyp",))
    scores = disc_dice(Samples(task, frames_of(pictures)))
    assert scores[:3] == pytest.approx([1.0] * 3, abs=0.02) and scores[3] < 0.5


def test_each_seed_trains_both_arms_on_each_fraction() -> None:
    cells = cells_of((0.1, 1.0), 2)
    assert len(cells) == len({*cells}) == 2 * (2 + 2 * 2)
    assert {(c.arm, c.fraction) for c in cells if c.seed == 1} == {
        (DISC, 0.0), (OURS, 0.0), (IMAGENET, 0.1), (OURS, 0.1), (IMAGENET, 1.0), (OURS, 1.0),
    }  # fmt: skip


def test_a_page_without_networks_is_refused() -> None:
    with pytest.raises(InputError, match="no networks yet"):
        page_text([])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "There is no data set bkai"),
        (["--fractions", "2"], "above 0, at most 1"),
        (["--seeds", "0"], "1 or more"),
    ],
)
def test_bad_input_is_told_on_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], message: str
) -> None:
    write_real(tmp_path / "real")
    command = ["converged.py", "--real", str(tmp_path / "real"), "--run", str(tmp_path / "run")]
    monkeypatch.setattr(sys, "argv", [*command, *words])
    with pytest.raises(SystemExit, match=message):
        converged.main()


@pytest.mark.slow
@pytest.mark.usefixtures("plain_stamp")
def test_a_run_resumes_and_writes_its_section(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("segmentation_models_pytorch", reason="its package is not installed")
    real = write_real(tmp_path / "real")
    (real / "kvasir_seg").rename(real / "bkai")
    write_real(tmp_path / "real")
    page, run = tmp_path / "page.md", tmp_path / "run"
    command = ["converged.py", "--real", str(real), "--run", str(run), "--out", str(page)]
    command += ["--weights", str(WEIGHTS), "--seeds", "1", "--size", "32", "--steps", "1"]
    monkeypatch.setattr(sys, "argv", [*command, "--fractions", "0.5"])
    converged.main()
    text = page.read_text()
    for arm in ("ImageNet", "ImageNet + ours", "ImageNet + ours, averaged"):
        assert f"| 50 % | {arm} |" in text
    assert "| 0 % | centered disc |" in text
    lines = (run / ROWS).read_text().splitlines()
    assert len(lines) == 4
    (run / ROWS).write_text("\n".join(lines[:-1]) + "\n")
    capsys.readouterr()
    converged.main()
    assert "4 networks, 3 of them known." in capsys.readouterr().out
    again = (run / ROWS).read_text().splitlines()[-1]
    assert again.split('"seconds"')[0] == lines[-1].split('"seconds"')[0]
