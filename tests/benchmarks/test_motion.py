"""Classical odometry of `benchmarks.validation.motion`, and its page."""

import sys
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("torch", reason="PyTorch is not installed")
pytest.importorskip("segmentation_models_pytorch", reason="its package is not installed")
pytest.importorskip("cv2", reason="OpenCV is not installed")

from benchmarks.figures.summary import find, read_rows
from benchmarks.validation import motion
from tests.support.ellipsoid_sequence import blanked, spotted_sequence
from vrcaps.camera.lens import LensEquidistant
from vrcaps.cli.benchmarks.report import read_sections
from vrcaps.core.geometry import invert, rotation_from_vector, transform_from, transform_points
from vrcaps.metrics.trajectory import motion_errors
from vrcaps.tools.reconstruction.fusion.pose_adjustment import View

LENS = LensEquidistant(focal=80.0, cx=99.5, cy=99.5, max_angle=1.2)
STEP = transform_from(
    rotation_from_vector(np.array([0.02, -0.05, 0.04])), np.array([1e-3, 4e-4, 1.5e-3])
)


def views_of(poses: np.ndarray, num_wrong: int) -> list[View]:
    """The same places, seen by all cameras; the first descriptors of later ones are exchanged."""
    chance = np.random.default_rng(0)
    world = chance.uniform([-0.02, -0.02, 0.02], [0.02, 0.02, 0.06], (80, 3))
    unit = chance.standard_normal((80, 32)).astype(np.float32)
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    views = []
    for index, pose in enumerate(poses):
        points = transform_points(invert(pose), world)
        rays = points / np.linalg.norm(points, axis=1, keepdims=True)
        order = np.arange(80)
        order[:num_wrong] = order[:num_wrong][::-1] if index % 2 else order[:num_wrong]
        views.append(View(unit[order], rays, points))
    return views


@pytest.mark.parametrize("step", [motion.essential_step, motion.p3p_step])
def test_a_step_is_exact_in_spite_of_wrong_matches(step: motion.Step) -> None:
    one, other = views_of(np.stack([np.eye(4), STEP]), num_wrong=20)
    found = step(one, other, 1e-3)
    assert found is not None
    np.testing.assert_allclose(found, invert(STEP), atol=1e-4)
    few = View(one.descriptors[:6], one.rays[:6], one.points[:6])
    assert step(few, other, 1e-3) is None


def test_a_frame_without_matches_repeats_the_motion_before() -> None:
    truth = np.stack([np.linalg.matrix_power(STEP, k) for k in range(4)])
    views = views_of(truth, num_wrong=0)
    views[3] = View(views[3].descriptors[:6], views[3].rays[:6], views[3].points[:6])
    found = motion.chain(views, 1e-3, motion.p3p_step)
    np.testing.assert_allclose(found, truth, atol=1e-6)
    np.testing.assert_array_equal(motion.extrapolated(truth)[1], np.eye(4))
    np.testing.assert_allclose(motion.extrapolated(truth)[2:], truth[1:3], atol=1e-12)


@pytest.mark.slow
def test_adjusted_poses_of_all_frames_are_near_the_truth() -> None:
    sequence = spotted_sequence(LENS, 200, frames=5)
    truth = sequence.Ts_world_camera
    found = motion.adjusted_trajectory(blanked(sequence, {3}))
    assert len(found) == 5
    np.testing.assert_allclose(found[[1, 2, 4]], (invert(truth[0]) @ truth)[[1, 2, 4]], atol=2e-3)
    np.testing.assert_allclose(found[3], found[2] @ invert(found[1]) @ found[2], atol=1e-12)
    nothing = motion.adjusted_trajectory(blanked(sequence, set(range(5))))
    np.testing.assert_array_equal(nothing, np.tile(np.eye(4), (5, 1, 1)))
    assert motion_errors(found, truth)["direction"] > 0.9


@pytest.mark.slow
def test_the_page_compares_the_published_network_with_all_baselines(
    tmp_path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sequence = spotted_sequence(LENS, 200, frames=3)
    given = [replace(sequence, name=name, split=name) for name in ("test", "train")]
    monkeypatch.setattr(motion, "read_sources", lambda names: given)
    out = tmp_path / "page.md"
    words = ["--data", "runs/spots", "--split", "test", "--out", str(out)]
    monkeypatch.setattr(sys, "argv", ["motion", *words])
    monkeypatch.setattr(motion, "write_section", lambda page, script, text: page.write_text(text))
    motion.main()
    text = out.read_text(encoding="utf-8")
    rows = list(read_rows(text))
    named = [row["method"] for row in rows[: len(rows) // 2]]
    assert named[:6] == [
        *("sfm", "sfm, network alone", "direct alignment"),
        *("essential matrix", "P3P", "P3P, adjusted"),
    ]
    assert named[6:] == ["static", "constant velocity", "previous true step"]
    assert find(rows, "ATE [mm] | previous true step") == "–"
    moved = np.linalg.norm(sequence.Ts_world_camera[1, :3, 3] - sequence.Ts_world_camera[0, :3, 3])
    shown = find(rows, "step, translation [mm] | static")  # without an interval
    assert float(shown) == pytest.approx(1e3 * moved, rel=0.01)
    assert "**All**: 3 frames; 1 sequence." in text
    assert "ATE of `sfm` relative to that of others: " in text


@pytest.mark.slow
@pytest.mark.usefixtures("plain_stamp")
def test_sinus_data_have_a_section_with_and_without_intervals(
    tmp_path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    sequence = spotted_sequence(LENS, 200, frames=7)
    truth = sequence.Ts_world_camera
    double = truth.copy()
    double[:, :3, 3] *= 2.0
    monkeypatch.setattr(motion, "_WINDOW", 4)
    monkeypatch.setattr(motion, "read_sinus_sequence", lambda folder: sequence)
    monkeypatch.setattr(motion, "estimates_of", lambda *given: {"sfm": double})
    out = tmp_path / "page.md"
    monkeypatch.setattr(sys, "argv", ["motion", "--sinus", "runs/sinus", "--out", str(out)])
    motion.main()
    (text,) = (read_sections(out)[name] for name in read_sections(out) if name)
    assert list(read_sections(out)) == ["", "benchmarks.validation.motion sinus"]
    assert "`python -m benchmarks.validation.motion --sinus runs/sinus` from sources" in text
    assert "**Whole sequence**: 7 frames; 1 sequence." in text
    assert "**Windows of 4 frames**: 8 frames; intervals over 2 sequences." in text
    rows = list(read_rows(text))
    assert find(rows, "direction, cosine | sfm") == "1"
    step = np.linalg.norm(np.diff(truth[:, :3, 3], axis=0), axis=1).mean()
    assert float(find(rows, "step, translation [mm] | sfm")) == pytest.approx(1e3 * step, rel=0.01)
    monkeypatch.setattr(sys, "argv", ["motion"])
    with pytest.raises(SystemExit):
        motion.main()
    assert "Give --data, --sinus, or both." in capsys.readouterr().err
