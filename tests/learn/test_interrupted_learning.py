"""Failures during training and prediction: damaged images, a loss that is not finite."""

import json
from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed")

from tests.support.small_frames import image_of, small_sequence  # noqa: E402
from vrcaps.core.errors import InputError  # noqa: E402
from vrcaps.learn.checkpoint import TrainedNetwork  # noqa: E402
from vrcaps.learn.networks import Backbone  # noqa: E402
from vrcaps.learn.prediction import predict  # noqa: E402
from vrcaps.learn.samples import Samples, samples_of  # noqa: E402
from vrcaps.learn.settings import TrainSettings  # noqa: E402
from vrcaps.learn.tasks.segmentation import SegmentationTask  # noqa: E402
from vrcaps.learn.tasks.sfm import SfmTask  # noqa: E402
from vrcaps.learn.tasks.super_resolution import SuperResolutionTask  # noqa: E402
from vrcaps.learn.training import BEST, train  # noqa: E402
from vrcaps.training import ComputeSettings  # noqa: E402

LEARNER = SuperResolutionTask(2, size=32, blocks=1, features=8)
SETTINGS = TrainSettings(LEARNER, start="scratch", batch=2, steps=4, evaluate_every=2)


def _damaged(*numbers):
    """Small frames of which some cannot be read."""

    def load(channel, index):
        if index in numbers:
            raise InputError(f"Cannot read {index:06d}.png: cut short.")
        return image_of(channel, index)

    return replace(small_sequence(), load=load)


def _train(samples, out, settings=SETTINGS, **more):
    held_out = samples_of(LEARNER, [small_sequence(1, "other")])
    return train(settings, samples, held_out, out, compute=ComputeSettings("cpu"), **more)


def test_damaged_image_amid_training_is_skipped_counted_and_named(tmp_path):
    samples = Samples(LEARNER, [(_damaged(1), k) for k in range(4)])
    rows = _train(samples, tmp_path / "run").rows
    assert [row["skipped"] for row in rows] == [1.0, 1.0]
    assert samples.skipped == {"small, frame 1": "Cannot read 000001.png: cut short."}
    every = Samples(LEARNER, [(_damaged(*range(4)), k) for k in range(4)])
    with pytest.raises(InputError, match=r"No frame can be read: Cannot read 0000\d\d\.png: cut"):
        _train(every, tmp_path / "none")


def test_loss_that_is_no_number_stops_and_keeps_the_last_good_weights(tmp_path, monkeypatch):
    good = _train(samples_of(LEARNER, [small_sequence()]), tmp_path / "good")
    plain, steps = SuperResolutionTask.loss, []

    def loss(self, network, batch):
        steps.append(1)
        found = plain(self, network, batch)
        return {"loss": found["loss"] * (float("nan") if len(steps) == 4 else 1.0)}

    monkeypatch.setattr(SuperResolutionTask, "loss", loss)
    out = tmp_path / "run"
    with pytest.raises(InputError, match=r"The loss is nan at step 3\. .* are kept\. Try"):
        _train(samples_of(LEARNER, [small_sequence()]), out)
    assert (out / BEST).is_file()
    assert (out / "progress.csv").read_text().count("\n") == 2
    monkeypatch.undo()
    resumed = _train(samples_of(LEARNER, [small_sequence()]), out)
    assert resumed.best == good.best
    assert (out / BEST).read_bytes() == (tmp_path / "good" / BEST).read_bytes()


def test_training_of_a_version_that_noted_less_goes_on(tmp_path):
    """Settings of a training that was begun before `validation` was one of them."""
    whole = _train(samples_of(LEARNER, [small_sequence()]), tmp_path / "run")
    path = tmp_path / "run" / "settings.json"
    stated = json.loads(path.read_text())
    del stated["settings"]["validation"]
    path.write_text(json.dumps(stated))
    assert _train(samples_of(LEARNER, [small_sequence()]), tmp_path / "run") == whole
    other = replace(SETTINGS, validation=("runs/other",))
    with pytest.raises(InputError, match=r"other settings: validation was None, now \['runs"):
        _train(samples_of(LEARNER, [small_sequence()]), tmp_path / "run", other)


def test_masks_of_another_size_than_their_images_are_named():
    def load(channel, index):
        image = image_of(channel, index)
        return image[:-1] if channel == "instance" else image

    samples = samples_of(
        SegmentationTask(backbone=Backbone(32)), [replace(small_sequence(), load=load)]
    )
    with pytest.raises(InputError, match=r"an image of \(48, 48\) and a mask of \(47, 48\) pixels"):
        samples.next(0)


@pytest.mark.slow
def test_trajectory_leaves_out_what_cannot_be_read(tmp_path):
    pytest.importorskip("segmentation_models_pytorch", reason="its package is not installed")
    learner = SfmTask(backbone=Backbone(32, "test_resnet"))
    torch.manual_seed(0)
    trained = TrainedNetwork(learner, learner.network(is_pretrained=False).eval(), {})
    sequences = (_damaged(3, 4), replace(_damaged(*range(20)), name="black"))
    progress: list[tuple[int, int]] = []
    skipped = predict(
        trained, sequences, tmp_path / "out", progress=lambda *step: progress.append(step)
    )
    assert len(skipped) == 22
    done = [step[0] for step in progress]
    assert done == sorted(set(done)) and progress[-1] == (80, 80)
    assert sum(count > 62 for count in done) == 18, "one step for each image of the trajectory"
    assert skipped["small/000003"] == "Cannot read 000003.png: cut short."
    rows = np.loadtxt(tmp_path / "out/small/trajectory.txt")
    expected = np.delete(small_sequence().times, [3, 4])
    np.testing.assert_allclose(rows[:, 0], expected)
    assert not (tmp_path / "out/black/trajectory.txt").exists()


@pytest.mark.slow
def test_tensorboard_shows_what_progress_says(tmp_path):
    accumulator = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    samples = samples_of(LEARNER, [small_sequence()])
    rows = _train(samples, tmp_path / "run", tensorboard=True).rows
    events = accumulator.EventAccumulator(str(tmp_path / "run" / "tensorboard"))
    events.Reload()
    found = events.Scalars("evaluation/psnr")
    assert [one.step for one in found] == [2, 4]
    np.testing.assert_allclose([one.value for one in found], [row["psnr"] for row in rows], 1e-6)
    assert {f"evaluation/{name}" for name in rows[0]} == set(events.Tags()["scalars"])
    (picture, _) = events.Images("pictures")
    assert picture.width > 0 and picture.encoded_image_string.startswith(b"\x89PNG")
