"""Trivial baselines, their intervals, perturbed frames, and networks that ignore their input."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed")
pytest.importorskip("segmentation_models_pytorch", reason="its package is not installed")

from tests.support.small_frames import SIDE, small_sequence  # noqa: E402
from vrcaps.cli.learn_tables import (  # noqa: E402
    print_comparison,
    print_perturbed,
    warn_if_constant,
)
from vrcaps.formats.io import read_source  # noqa: E402
from vrcaps.learn.baselines import (  # noqa: E402
    class_baselines,
    log_depth_baselines,
    mask_baselines,
)
from vrcaps.learn.card_results import results_of  # noqa: E402
from vrcaps.learn.checkpoint import TrainedNetwork  # noqa: E402
from vrcaps.learn.evaluation import (  # noqa: E402
    NETWORK,
    UNPERTURBED,
    Evaluation,
    compared,
    evaluate,
    perturbed,
    read_evaluation,
    worst_frames,
    write_evaluation,
)
from vrcaps.learn.networks import Backbone  # noqa: E402
from vrcaps.learn.perturbation import PERTURBATIONS, Perturbation  # noqa: E402
from vrcaps.learn.picture_border import Letterbox  # noqa: E402
from vrcaps.learn.prediction import predict  # noqa: E402
from vrcaps.learn.publishing import constant_outputs  # noqa: E402
from vrcaps.learn.samples import frame_groups, samples_of  # noqa: E402
from vrcaps.learn.tasks.classification import ClassificationTask  # noqa: E402
from vrcaps.learn.tasks.depth import DepthTask  # noqa: E402
from vrcaps.learn.tasks.segmentation import SegmentationTask  # noqa: E402
from vrcaps.learn.tasks.sfm import SfmTask  # noqa: E402
from vrcaps.learn.tasks.super_resolution import SuperResolutionTask  # noqa: E402
from vrcaps.recording.frame_files import read_image, write_images  # noqa: E402

LEARNERS = (
    DepthTask(backbone=Backbone(32)),
    SegmentationTask(classes=("lesion",), backbone=Backbone(32)),
    ClassificationTask(("normal", "polyp"), backbone=Backbone(32), mask_overlays=()),
    SuperResolutionTask(2, size=32, blocks=1, features=8),
    SfmTask(backbone=Backbone(32)),
)
ids = [learner.kind for learner in LEARNERS]


def external(seed: int = 0, **more):
    """Frames with a label instead of instances, as of an image folder."""
    one = small_sequence(seed, **more)

    def load(channel: str, index: int) -> np.ndarray:
        return one.load("instance" if channel == "label" else channel, index)

    return replace(
        one, channels=("rgb", "depth", "label"), label_names=("background", "lesion"), load=load
    )


@cache
def trained_of(learner, *, is_constant: bool = False) -> TrainedNetwork:
    """A network with random weights, all zero if it is constant; tests leave it as it is."""
    torch.manual_seed(3)
    network = learner.network(is_pretrained=False).eval()
    for value in network.parameters():
        if is_constant or not value.any():
            torch.nn.init.zeros_(value) if is_constant else torch.nn.init.normal_(value, std=0.3)
    return TrainedNetwork(learner, network, {})


@pytest.mark.parametrize("learner", LEARNERS, ids=ids)
def test_outputs_depend_on_the_input_unless_the_network_is_constant(learner, capsys) -> None:
    assert constant_outputs(trained_of(learner)) == {}
    warn_if_constant(trained_of(learner))
    assert capsys.readouterr().out == ""
    if learner.kind == "super-resolution":
        return  # without its network it still enlarges
    warn_if_constant(trained_of(learner, is_constant=True))
    (line,) = capsys.readouterr().out.splitlines()
    assert line.startswith("Warning: output does not depend on the input: ")


@pytest.mark.parametrize("learner", LEARNERS, ids=ids)
def test_predict_writes_what_evaluate_scores(learner, tmp_path) -> None:
    """Files of a prediction are those of the outputs that `evaluate` scores for the same files."""
    trained, one = trained_of(learner), external().subset(range(0, 20, 3))
    if learner.kind == "super-resolution":
        found = evaluate(trained, samples_of(learner, [one]))
        (tmp_path / "in").mkdir()
        images = [sample["image"] for sample in found.samples]
        write_images([(tmp_path / "in" / f"{k:03}.png", x) for k, x in enumerate(images)])
        (given,) = read_source(str(tmp_path / "in"))
    else:
        given = one
        found = evaluate(trained, samples_of(learner, [one]))
    predict(trained, (given,), tmp_path / "out")
    if learner.kind == "classification":
        lines = (tmp_path / "out" / "classification.csv").read_text().splitlines()
        for line, output in zip(lines[1:], found.outputs, strict=True):
            row = learner.row(output)
            name, *values = line.split(",")[1:]
            expected = [float(str(value)) for value in list(row.values())[1:]]
            assert name == row["class"]
            assert list(map(float, values)) == pytest.approx(expected, abs=2e-4)
        return
    letterbox = Letterbox(SIDE, SIDE, learner.input_size)
    for output, (_, index) in zip(found.outputs, found.frames, strict=True):
        for suffix, expected in learner.files(output, letterbox).items():
            (path,) = (tmp_path / "out").rglob(f"*{index:03}{suffix}")
            # Batches of other sizes round differently.
            difference = read_image(path).astype(int) - expected.astype(int)
            assert (np.abs(difference) > 1).mean() < 1e-3


@pytest.mark.parametrize("learner", LEARNERS, ids=ids)
def test_a_comparison_lists_network_and_baselines_with_intervals(learner, capsys) -> None:
    trained = trained_of(learner)
    found = evaluate(trained, samples_of(learner, [external()]))
    table, groups = compared(learner, found)
    assert groups == "20 blocks" or learner.kind == "sfm"
    names = {
        "depth": {"constant", "mean image", "brightness"},
        "segmentation": {"nothing", "whole image", "centered disc", "redness"},
        "classification": {"most frequent", "mean redness", "mean brightness"},
        "super-resolution": {"bicubic", "nearest"},
        "sfm": {"constant", "mean image", "brightness"},
    }[learner.kind]
    assert next(iter(table)) == NETWORK and set(table) == {NETWORK, *names}
    for scores in table.values():
        for value, low, high in scores.values():
            assert not np.isfinite(value) or low <= value <= high
    print_comparison(table, found.metrics, "20 frames", groups)
    shown = capsys.readouterr().out
    assert all(name.split()[0] in shown for name in names)


def test_brightness_counts_relative_to_the_exposure() -> None:
    """Of two equal images, that of four times the exposure shows a wall at twice the distance."""
    image = np.full((32, 32, 3), 120, np.uint8)
    one = {"image": image, "depth": np.full((32, 32), 0.02), "exposure": np.float32(1.0)}
    logs = log_depth_baselines([one, one | {"exposure": np.float32(4.0)}], ["a", "b"])
    np.testing.assert_allclose(logs["brightness"][1] - logs["brightness"][0], np.log(2.0))


def test_brightness_is_exact_for_a_facing_wall_of_one_color() -> None:
    """Light falls with the square of distance, so brightness beats a constant on such frames."""
    learner = DepthTask(backbone=Backbone(32))
    samples = samples_of(learner, [external()])
    known = [samples.next(k) for k in range(0, 20, 2)]  # without the red disk
    scores = {
        name: learner.metrics(outputs, known)
        for name, outputs in learner.baselines(known, [str(k) for k in range(10)]).items()
    }
    assert scores["brightness"]["rank"] > 0.8 > scores["mean image"]["rank"]
    assert scores["constant"]["rank"] == 0.0
    assert scores["constant"]["scale"] == pytest.approx(1.0, rel=0.1)


def test_the_mean_image_is_that_of_other_groups() -> None:
    """A frame alone in its group gets nothing of itself; one group alone gets the constant."""
    learner = DepthTask(backbone=Backbone(32))
    first, second = (
        {"image": np.zeros((4, 4, 3), np.uint8), "depth": np.full((4, 4), depth)}
        for depth in (0.01, 0.04)
    )
    images = learner.baselines([first, second], ["a", "b"])["mean image"]
    np.testing.assert_allclose(0.03 * np.exp(images), [np.full((1, 4, 4), d) for d in (0.04, 0.01)])
    alone = learner.baselines([first, second], ["a", "a"])
    np.testing.assert_allclose(alone["mean image"], alone["constant"])


def test_redness_and_disc_find_masks_that_they_fit() -> None:
    y, x = np.mgrid[:64, :64] - 31.5
    disc, corner = np.hypot(x, y) <= 0.3 * 64, (x > 0) & (y > 0)
    image = np.where(corner[..., None], [200, 30, 30], [120, 100, 90]).astype(np.uint8)
    by_color = mask_baselines([image, image], [corner, corner])
    assert (by_color["redness"][0] == corner).all()
    by_place = mask_baselines([image, image], [disc, disc])
    assert (by_place["centered disc"][1] == disc).all()
    assert by_place["whole image"][0].all() and not by_place["nothing"][0].any()


def test_classes_of_other_color_are_told_apart_by_redness() -> None:
    red, pale = (np.full((8, 8, 3), color, np.uint8) for color in ((200, 40, 40), (120, 110, 100)))
    found = class_baselines([red, pale, red, pale, pale], [1, 0, 1, 0, 0], 2)
    assert [int(one.argmax()) for one in found["mean redness"]] == [1, 0, 1, 0, 0]
    assert {int(one.argmax()) for one in found["most frequent"]} == {0}


def test_groups_are_patients_or_sequences_or_blocks() -> None:
    def kinds(sequences) -> tuple[int, str]:
        frames = [(one, k) for one in sequences for k in range(len(one))]
        groups, kind = frame_groups(frames)
        return len(set(groups)), kind

    patients = [small_sequence(name=f"s{k}", patient=f"p{k // 2}") for k in range(10)]
    assert kinds(patients) == (5, "patient")
    assert kinds([replace(one, patient=None) for one in patients]) == (10, "sequence")
    assert kinds(patients[:4]) == (20, "block")
    assert kinds([small_sequence()]) == (20, "block")


def test_border_and_crop_move_lens_and_labels() -> None:
    """A point keeps its ray: the lens follows the pixels, and added pixels have no label."""
    one = external()
    for change, margin in (
        (Perturbation("b", border=0.25), 12),
        (Perturbation("c", crop=0.5), -12),
    ):
        moved = change.sequence(one)
        side = SIDE + 2 * margin
        assert moved.image("rgb", 1).shape == (side, side, 3)
        assert moved.camera is not None and one.camera is not None
        assert (moved.camera.width, moved.camera.height) == (side, side)
        pixel = np.array([[20.0, 25.0]])
        np.testing.assert_allclose(
            moved.camera.lens.unproject(pixel + margin), one.camera.lens.unproject(pixel)
        )
        row, column = 25 + margin, 20 + margin
        assert moved.image("depth", 1)[row, column] == one.image("depth", 1)[25, 20]
    bordered = Perturbation("b", border=0.25).sequence(one)
    assert np.isnan(bordered.image("depth", 0)[0, 0])
    assert bordered.image("label", 1)[0].max() == 0


def test_exposure_scales_linear_light_and_noise_is_the_same_again() -> None:
    gray = np.full((16, 16, 3), 188, np.uint8)  # linear 0.5
    assert Perturbation("e", exposure=0.5).recolored(gray, 0)[0, 0, 0] == 137  # linear 0.25
    assert (Perturbation("e", exposure=4.0).recolored(gray, 0) == 255).all()
    noisy = [Perturbation("n", noise=8.0).recolored(gray, index) for index in (0, 0, 1)]
    assert (noisy[0] == noisy[1]).all() and (noisy[0] != noisy[2]).any()
    assert np.std(noisy[0].astype(float)) == pytest.approx(8.0, rel=0.15)
    coded = Perturbation("j", jpeg=10).recolored(small_sequence().image("rgb", 0), 0)
    assert (coded != small_sequence().image("rgb", 0)).any()


@pytest.mark.parametrize("learner", LEARNERS[:4], ids=ids[:4])
def test_perturbations_reach_the_network(learner, capsys) -> None:
    trained, few = trained_of(learner), external().subset([0, 5])
    seen: list[tuple[int, int]] = []
    rows, gains = perturbed(
        trained, samples_of(learner, [few]), progress=lambda *counts: seen.append(counts)
    )
    total = 2 * (1 + len(PERTURBATIONS))
    assert seen == sorted(set(seen)) and seen[-1] == (total, total)
    assert list(rows) == [UNPERTURBED, *(one.name for one in PERTURBATIONS)]
    whole = evaluate(trained, samples_of(learner, [few]))
    assert rows[UNPERTURBED][NETWORK] == whole.metrics[learner.metric.name]
    assert list(gains) == list(rows)
    for values, differences in zip(rows.values(), gains.values(), strict=True):
        assert [*differences] == [name for name in values if name != NETWORK]
        for name, (gain, low, high) in differences.items():
            assert gain == pytest.approx(values[NETWORK] - values[name], nan_ok=True)
            assert not low > gain + 1e-9 and not high < gain - 1e-9
    print_perturbed(rows, gains, learner.metric.name)
    shown = capsys.readouterr().out
    assert shown.count("exposure × 0.1") == 2 and "minus that of each baseline" in shown
    if learner.kind == "super-resolution":  # truth stays clean
        sample = learner.perturbed_sample(external(), 1, Perturbation("dark", exposure=0.1))
        np.testing.assert_array_equal(sample["truth"], learner.sample(external(), 1)["truth"])
        assert sample["image"].max() < 120


def test_an_evaluation_keeps_its_tables(tmp_path) -> None:
    nan = float("nan")
    table = {NETWORK: {"dice": (0.5, 0.4, 0.6)}, "nothing": {"dice": (0.0, nan, nan)}}
    gains = {"JPEG 75": {"nothing": (0.5, 0.4, nan)}}
    stated = "segmentation", "0", ("a",), "", 3, 0, {"dice": 0.5}, table, {}, "3 blocks", gains
    one = Evaluation(*stated)
    write_evaluation(tmp_path, one)
    read = read_evaluation(tmp_path)
    np.testing.assert_array_equal(read.table["nothing"]["dice"], [0.0, nan, nan])
    np.testing.assert_array_equal(read.gains["JPEG 75"]["nothing"], [0.5, 0.4, nan])
    assert read.groups == "3 blocks" and read.scores == {"dice": 0.5}


def test_a_card_shows_baselines_perturbed_frames_and_the_command() -> None:
    table = {NETWORK: {"dice": (0.5, 0.4, 0.6)}, "whole image": {"dice": (0.3, 0.2, 0.4)}}
    rows = {name: {NETWORK: 0.25, "whole image": 0.3} for name in (UNPERTURBED, "JPEG 75")}
    gains = {name: {"whole image": (-0.05, -0.1, 0.02)} for name in rows}
    stated = "segmentation", "0", ("images:a",), "test", 3, 0
    one = Evaluation(*stated, {"dice": 0.5}, table, rows, "3 blocks", gains)
    lines = results_of({"dice": 0.7}, [one], "segmentation")
    assert "| dice | 0.5 [0.4, 0.6] | 0.3 [0.2, 0.4] |" in lines
    assert "| JPEG 75 | 0.25 | 0.3 | -0.05 [-0.1, 0.02] |" in lines
    expected = "vrcaps evaluate segmentation --weights segmentation --data images:a --split test"
    assert f"{expected} --perturb" in lines
    plain = results_of({"dice": 0.7}, [], "segmentation")
    assert "| dice | 0.7 |" in plain and not any("Baselines" in line for line in plain)


def test_the_worst_frames_come_first() -> None:
    learner = DepthTask(backbone=Backbone(32))
    found = evaluate(trained_of(learner), samples_of(learner, [external()]))
    errors = [
        learner.metrics([output], [sample])["abs_rel"]
        for output, sample in zip(found.outputs, found.samples, strict=True)
    ]
    assert worst_frames(learner, found) == np.argsort(errors)[::-1][:6].tolist()
