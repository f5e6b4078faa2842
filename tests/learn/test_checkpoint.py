"""Files of weights: what they state is checked before networks are made."""

import json
import struct

import numpy as np
import pytest

pytest.importorskip("torch")

import torch
from safetensors import safe_open
from safetensors.torch import save_file

from vrcaps.config.convert import to_plain
from vrcaps.core.errors import InputError
from vrcaps.learn.augment import Augmentation
from vrcaps.learn.checkpoint import read_weights, write_weights
from vrcaps.learn.networks import Backbone
from vrcaps.learn.settings import TrainSettings, read_settings
from vrcaps.learn.tasks.classification import ClassificationTask
from vrcaps.learn.tasks.depth import DepthTask
from vrcaps.learn.tasks.segmentation import SegmentationTask
from vrcaps.learn.tasks.sfm import SfmTask
from vrcaps.learn.tasks.super_resolution import SuperResolutionTask

LEARNER = SuperResolutionTask(blocks=1, features=8)


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> bytes:
    path = tmp_path_factory.mktemp("weights") / "w.safetensors"
    write_weights(path, LEARNER, LEARNER.network(is_pretrained=False), {"steps": 1})
    return path.read_bytes()


def _changed(whole: bytes, change) -> bytes:
    """The file with another text about itself."""
    (length,) = struct.unpack("<Q", whole[:8])
    header = json.loads(whole[8 : 8 + length])
    stated = change(json.loads(header["__metadata__"]["vrcaps"]))
    header["__metadata__"]["vrcaps"] = json.dumps(stated)
    text = json.dumps(header).encode()
    return struct.pack("<Q", len(text)) + text + whole[8 + length :]


def _with(key, value):
    def change(stated):
        stated["learner"][key] = value
        return stated

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda stated: [], "contains no weights of vrcaps"),
        (lambda stated: None, "contains no weights of vrcaps"),
        (lambda stated: "text", "contains no weights of vrcaps"),
        (lambda stated: {**stated, "task": []}, "contains no weights of vrcaps"),
        (lambda stated: {**stated, "about": None}, "'about' is not a table"),
        (lambda stated: {**stated, "learner": None}, "does not fit this version"),
        (_with("blocks", 1_000_000), r"blocks is 1000000\. Allowed: 1 to 128"),
        (_with("features", 10**9), r"features is 1000000000\. Allowed: 8 to 1024"),
        (_with("size", 10**6), r"size is 1000000\. Allowed: 32 to 2048"),
        (_with("validation_size", 10**6), r"validation_size is 1000000"),
        (_with("content", 1e300), r"content is 1e\+300"),
        (_with("blocks", 2), r"weights do not fit the stated network, such as .*missing"),
        (_with("features", 16), r"weights do not fit the stated network"),
    ],
)
def test_a_stated_network_is_checked_first(whole, tmp_path, change, message):
    path = tmp_path / "w.safetensors"
    path.write_bytes(_changed(whole, change))
    with pytest.raises(InputError, match=message):
        read_weights(path)


def test_no_memory_is_taken_before_shapes_are_compared(whole, tmp_path, monkeypatch):
    """The only network that is made of wrong weights has no numbers."""
    path, made = tmp_path / "w.safetensors", []
    path.write_bytes(_changed(whole, _with("features", 1024)))
    network = SuperResolutionTask.network

    def noted(self, **options):
        made.append(network(self, **options))
        return made[-1]

    monkeypatch.setattr(SuperResolutionTask, "network", noted)
    with pytest.raises(InputError, match="do not fit the stated network"):
        read_weights(path)
    assert [next(one.parameters()).device.type for one in made] == ["meta"]


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_numbers_are_finite(tmp_path, value):
    network = LEARNER.network(is_pretrained=False)
    with torch.no_grad():
        next(network.parameters()).view(-1)[3] = value
    write_weights(tmp_path / "w.safetensors", LEARNER, network, {})
    with pytest.raises(InputError, match="contains values that are not finite, in "):
        read_weights(tmp_path / "w.safetensors")


@pytest.mark.parametrize(
    ("value", "dtype", "message"),
    [
        (1e300, torch.float64, "contains values that are not finite, in "),
        (3, torch.int32, r"has values of type torch\.int32, not torch\.float32"),
        (1j, torch.complex64, r"has values of type torch\.complex64, not torch\.float32"),
    ],
)
def test_numbers_are_of_the_type_of_the_network(whole, tmp_path, value, dtype, message):
    (tmp_path / "w.safetensors").write_bytes(whole)
    with safe_open(tmp_path / "w.safetensors", "pt") as file:
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        metadata = file.metadata()
    name = next(name for name, tensor in tensors.items() if tensor.is_floating_point())
    tensors[name] = torch.full(tensors[name].shape, value, dtype=dtype)
    save_file(tensors, tmp_path / "w.safetensors", metadata)
    with pytest.raises(InputError, match=message):
        read_weights(tmp_path / "w.safetensors")


def test_whole_weights_are_read(whole, tmp_path):
    (tmp_path / "w.safetensors").write_bytes(whole)
    assert read_weights(tmp_path / "w.safetensors").metadata == {"steps": 1}


@pytest.mark.parametrize(
    ("owner", "setting", "value"),
    [
        (Backbone, "size", 4096),
        (Augmentation, "exposure_jitter", 1e9),
        (Augmentation, "color_jitter", 1e9),
        (Augmentation, "gamma_jitter", 1e9),
        (DepthTask, "gradient_weight", 1e9),
        (SfmTask, "step", 10**9),
        (SfmTask, "supervision", 1e9),
        (SfmTask, "photometric_weight", 1e9),
        (SfmTask, "smoothness_weight", 1e9),
        (SfmTask, "geometry_weight", 1e9),
        (SuperResolutionTask, "adversarial", 1e9),
        (SuperResolutionTask, "style", 1e9),
        (SuperResolutionTask, "halvings", 99),
        (SegmentationTask, "classes", ("a",) * 1001),
        (ClassificationTask, "classes", tuple(map(str, range(1001)))),
    ],
)
def test_settings_of_all_tasks_have_upper_limits(owner, setting, value):
    with pytest.raises(InputError, match="Allowed: "):
        owner(**{setting: value})


FORMER = {
    "masks": (
        {"classes": ["polyp"], "size": 64, "encoder": "test_resnet", "brightness": 1.5}
        | {"tint": 1.35, "zoom": 0.5},
        SegmentationTask(
            ("polyp",),
            backbone=Backbone(64, "test_resnet"),
            augmentation=Augmentation(1.5, 1.35, 1.3, 0.5),
        ),
    ),
    "classes": (
        {"classes": ["normal", "polyp"], "hides": ["text"], "size": 32, "zoom": 0.9},
        ClassificationTask(
            ("normal", "polyp"),
            backbone=Backbone(32),
            mask_overlays=("text",),
            augmentation=Augmentation(1.3, 1.25, 1.3, 0.9),
        ),
    ),
    "depth": (
        {"gamma": 1.0, "brightness": 1.1, "has_light_cue": False},
        DepthTask(has_light_cue=False, augmentation=Augmentation(1.1, 1.2, 1.0, 0.6)),
    ),
    "super-resolution": ({"size": 64, "factor": 2}, SuperResolutionTask(2, 64)),
}


@pytest.mark.parametrize("kind", FORMER)
def test_former_names_of_tasks_and_settings_are_read(kind):
    plain, task = FORMER[kind]
    settings = read_settings({"learner": {"kind": kind, **plain}, "rate": 1e-3}, at="settings")
    assert settings == TrainSettings(task, learning_rate=1e-3)
    now = to_plain(settings, TrainSettings)
    assert read_settings(now, at="settings") == settings
    assert {"learner", "rate", "size"}.isdisjoint(now)


def test_former_names_beside_current_ones_are_unknown():
    plain = {"backbone": {"size": 64}, "size": 32}
    with pytest.raises(InputError, match=r"Unknown key settings\.task\.size"):
        read_settings({"task": {"kind": "depth", **plain}}, at="settings")
