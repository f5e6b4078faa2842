"""ONNX files of every task: what ONNX Runtime makes of them is what PyTorch makes."""

import json
from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed")
runtime = pytest.importorskip("onnxruntime", reason="ONNX Runtime is not installed")
pytest.importorskip("onnx", reason="its package is not installed")
pytest.importorskip("segmentation_models_pytorch", reason="its package is not installed")

from vrcaps import cli  # noqa: E402
from vrcaps.config.convert import to_plain  # noqa: E402
from vrcaps.core.errors import InputError  # noqa: E402
from vrcaps.learn.checkpoint import TrainedNetwork, onnx_difference, write_onnx, write_weights  # noqa: E402  # noqa: E402
from vrcaps.learn.networks import Backbone  # noqa: E402
from vrcaps.learn.registry import TASKS  # noqa: E402
from vrcaps.learn.tasks.classification import ClassificationTask  # noqa: E402
from vrcaps.learn.tasks.depth import DepthTask  # noqa: E402
from vrcaps.learn.tasks.segmentation import SegmentationTask  # noqa: E402
from vrcaps.learn.tasks.sfm import SfmTask  # noqa: E402
from vrcaps.learn.tasks.super_resolution import SuperResolutionTask  # noqa: E402

SMALL = "test_resnet"
"""An encoder that timm has for tests."""
TINY = {
    one.kind: one
    for one in (
        DepthTask(backbone=Backbone(32, SMALL)),
        SegmentationTask(("polyp", "ulcer"), backbone=Backbone(32, SMALL)),
        ClassificationTask(backbone=Backbone(32, SMALL)),
        SuperResolutionTask(2, size=32, blocks=1, features=8),
        SfmTask(backbone=Backbone(32, SMALL)),
    )
}


AVERAGED = {
    f"{one}, mirrored": replace(TINY[one], mirroring=True) for one in ("depth", "segmentation")
}


def _trained(learner):
    """A new network whose layers all take part."""
    torch.manual_seed(0)
    network = learner.network(is_pretrained=False)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.add_(0.02 * torch.randn_like(parameter))
    return TrainedNetwork(learner, network.eval(), {})


def test_every_task_is_tested():
    assert set(TINY) == set(TASKS)


@pytest.mark.slow
@pytest.mark.parametrize("task", [*TINY, *AVERAGED])
def test_onnx_runtime_gives_what_pytorch_gives(task, tmp_path):
    learner = (TINY | AVERAGED)[task]
    trained = _trained(learner)
    path = tmp_path / "network.onnx"
    write_onnx(path, trained)
    assert onnx_difference(path, trained) < 1e-4
    session = runtime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    assert [one.name for one in session.get_inputs()] == list(trained.task.input_names)
    said = session.get_modelmeta().custom_metadata_map
    assert (said["task"], said["output"]) == (learner.kind, trained.task.output_text)
    assert json.loads(said["learner"]) == to_plain(learner, type(learner))
    for count in (1, 5):
        side = 40 if task == "super-resolution" else 32
        given = {
            name: np.random.default_rng(count).random((count, 3, side, 32), dtype=np.float32)
            for name in trained.task.input_names
        }
        (found,) = session.run(None, given)
        expected = trained({name: torch.from_numpy(one) for name, one in given.items()})
        np.testing.assert_allclose(found, expected, atol=1e-4)
    assert [file.name for file in tmp_path.iterdir()] == ["network.onnx"]


@pytest.mark.slow
def test_command_writes_and_compares(tmp_path, capsys):
    learner = TINY["super-resolution"]
    weights = tmp_path / "w.safetensors"
    write_weights(weights, learner, _trained(learner).network, {})
    cli.main(["weights", "export", str(weights), "--out", str(tmp_path / "w.onnx")])
    assert "differ from those of PyTorch by at most" in capsys.readouterr().out
    with pytest.raises(InputError, match=r"w\.txt\. Allowed: a name that ends in \.onnx"):
        cli._parse(["weights", "export", str(weights), "--out", str(tmp_path / "w.txt")]).run()
