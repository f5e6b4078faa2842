"""Outputs of published networks depend on their inputs; a constant network is found."""

from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed")

from tests.support.small_frames import SIDE, small_sequence  # noqa: E402
from vrcaps.core.errors import InputError  # noqa: E402
from vrcaps.learn.checkpoint import TrainedNetwork, read_weights  # noqa: E402
from vrcaps.learn.hub import read_index  # noqa: E402
from vrcaps.learn.networks import Backbone  # noqa: E402
from vrcaps.learn.picture_border import Letterbox  # noqa: E402
from vrcaps.learn.publishing import (  # noqa: E402
    MIN_RESPONSE,
    probes,
    require_responses,
    responses,
)
from vrcaps.learn.tasks.classification import ClassificationTask  # noqa: E402
from vrcaps.learn.tasks.sfm import SfmTask  # noqa: E402
from vrcaps.learn.tasks.super_resolution import SuperResolutionTask  # noqa: E402

OURS = Path(__file__).parents[2] / "weights"
PUBLISHED = tuple(read_index(str(OURS)).values())


def pictures() -> list[np.ndarray]:
    """Two rendered frames, noise, and a lit mucosa with a dark lumen and a highlight."""
    frames = small_sequence()
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:SIDE, :SIDE] / (SIDE - 1.0)
    far = np.hypot(x - 0.6, y - 0.4)
    photo = np.array([200.0, 110.0, 90.0]) * np.clip(0.2 + 1.2 * far, 0.0, 1.0)[..., None]
    photo += rng.normal(0.0, 6.0, photo.shape)
    photo[np.hypot(x - 0.2, y - 0.7) < 0.05] = 255.0
    noise = rng.integers(0, 256, (SIDE, SIDE, 3))
    shown = [frames.image("rgb", k) for k in (0, len(frames) - 1)]
    return [*shown, *(np.clip(one, 0, 255).astype(np.uint8) for one in (photo, noise))]


def samples(trained: TrainedNetwork) -> list[dict]:
    """Network's inputs of the pictures, all by one camera."""
    camera = small_sequence().camera
    fit = Letterbox(SIDE, SIDE, trained.task.input_size)
    return [trained.task.inputs(picture, fit, camera) for picture in pictures()]


def cropped(trained: TrainedNetwork, probe: dict) -> dict:
    """The probe with 64 x 64 pixels for a network that enlarges, which takes images of any size."""
    side = 64 if trained.task.kind == "super-resolution" else None
    return {**probe, "image": probe["image"][:side, :side]}


@pytest.mark.slow
@pytest.mark.parametrize("entry", PUBLISHED, ids=lambda entry: entry.name)
def test_no_published_network_ignores_its_inputs(entry) -> None:
    """Each output changes with each input by more than a hundredth of its size."""
    trained = read_weights(OURS / entry.file)
    by_probes = responses(trained, [cropped(trained, probe) for probe in probes(trained)])
    assert set(by_probes) >= {f"output 0 by {name}" for name in trained.task.input_names}
    assert min(by_probes.values()) > MIN_RESPONSE
    by_image = {k: v for k, v in responses(trained, samples(trained)).items() if "image" in k}
    assert min(by_image.values()) > MIN_RESPONSE


@pytest.mark.slow
def test_a_constant_network_is_found() -> None:
    """A classifier whose last layer is zero, and a network of motion that is."""
    learner = ClassificationTask(("normal", "polyp"), backbone=Backbone(32))
    untrained = TrainedNetwork(learner, learner.network(is_pretrained=False).eval(), {})
    found = responses(untrained, probes(untrained))
    assert found == {"output 0 by image": 0.0, "output 1 by image": 0.0}
    with pytest.raises(InputError, match=r"same output for all images: output 0 changes by 0 of"):
        require_responses(untrained)
    video = SfmTask(backbone=Backbone(32))
    network = video.network(is_pretrained=False).eval()
    for value in network.moves.features[-1].parameters():
        torch.nn.init.zeros_(value)
    with pytest.raises(InputError, match="motion 0 changes by"):
        require_responses(TrainedNetwork(video, network, {}))


def test_enlarging_responds_to_the_image() -> None:
    learner = SuperResolutionTask(2, size=32, blocks=1, features=8)
    trained = TrainedNetwork(learner, learner.network(is_pretrained=False).eval(), {})
    require_responses(trained)
    same = probes(trained)[:1] * 3
    assert max(responses(trained, same).values()) == 0.0
