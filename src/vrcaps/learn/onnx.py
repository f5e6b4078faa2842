"""Export of trained networks to ONNX, which runs without PyTorch."""

from __future__ import annotations

import json
import warnings
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np

from vrcaps.config.convert import to_plain
from vrcaps.core import rng
from vrcaps.core.errors import import_extra
from vrcaps.core.files import atomic_write
from vrcaps.learn.checkpoint import TrainedNetwork
from vrcaps.learn.networks import require_torch
from vrcaps.learn.task import INPUTS
from vrcaps.learn.tasks.super_resolution import SuperResolutionTask

_OUTPUT = "output"


def write_onnx(path: Path, trained: TrainedNetwork) -> None:
    """Write a trained network as ONNX atomically.

    The batch size is dynamic. For super-resolution the image size is dynamic as well, but for
    attention-unet both sides must be divisible by 2 per level. The file's metadata hold the task,
    its settings, and the inputs and outputs.

    Args:
        path: File to write.
        trained: Task and network; of `sfm` its distance network.

    Raises:
        MissingExtraError: If onnx is not installed.
    """
    torch, onnx = require_torch(), import_extra("onnx", "learn")
    learner = trained.learner
    free = {0: "batch"}
    if isinstance(learner, SuperResolutionTask):
        free |= {2: "height", 3: "width"}
    with atomic_write(path) as temporary, warnings.catch_warnings():
        # PyTorch's newer exporter creates the same graph but takes twenty times as long.
        warnings.simplefilter("ignore")
        torch.onnx.export(
            deepcopy(trained.network).cpu().eval(),
            tuple(torch.from_numpy(one) for one in _example(trained).values()),
            str(temporary),
            dynamo=False,
            input_names=list(learner.input_names),
            output_names=[_OUTPUT],
            dynamic_axes=dict.fromkeys((*learner.input_names, _OUTPUT), free),
        )
        model = onnx.load(temporary)
        stated = {
            "task": learner.kind,
            "learner": json.dumps(to_plain(learner, type(learner)), sort_keys=True),
            **{name: INPUTS[name] for name in learner.input_names},
            _OUTPUT: learner.output_text,
        }
        onnx.helper.set_model_props(model, stated)
        onnx.save(model, temporary)


def onnx_difference(path: Path, trained: TrainedNetwork) -> float:
    """Maximum absolute difference between the outputs of an ONNX file and of the network.

    It is computed on three random inputs, a batch size other than that of the export.

    Raises:
        MissingExtraError: If onnxruntime is not installed.
    """
    runtime = import_extra("onnxruntime", "dev")
    given = _example(trained, count=3)
    session = runtime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    (found,) = session.run([_OUTPUT], given)
    torch = require_torch()
    expected = trained({name: torch.from_numpy(one) for name, one in given.items()})
    return float(np.abs(found - expected).max())


def _example(trained: TrainedNetwork, count: int = 2) -> dict[str, Any]:
    """Random inputs [n 3 s s] between 0 and 1."""
    size = trained.learner.size
    chance = rng.stream(0, "learn/onnx", count)
    return {
        name: chance.random((count, 3, size, size), dtype=np.float32)
        for name in trained.learner.input_names
    }
