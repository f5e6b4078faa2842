"""Trained networks as ONNX files, which run without PyTorch."""

from __future__ import annotations

import json
import warnings
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np

from vrcaps import rng
from vrcaps.errors import import_extra
from vrcaps.files import atomic_write
from vrcaps.learn.learner import INPUTS
from vrcaps.learn.networks import require_torch
from vrcaps.learn.super_resolution import SuperResolutionLearner
from vrcaps.learn.weights import Trained
from vrcaps.serialization import to_plain

_OUTPUT = "output"


def write_onnx(path: Path, trained: Trained) -> None:
    """Write a trained network as ONNX, whole or not at all.

    A batch may have any size; images for super-resolution, too, but those for attention-unet must
    have sides that its levels halve without a rest. Metadata of the file say the task, its
    settings, and what goes in and out.

    Args:
        path: File to write.
        trained: Learner and network; of `sfm` its network of distances.

    Raises:
        MissingExtraError: If onnx is not installed.
    """
    torch, onnx = require_torch(), import_extra("onnx", "learn")
    learner = trained.learner
    free = {0: "batch"}
    if isinstance(learner, SuperResolutionLearner):
        free |= {2: "height", 3: "width"}
    with atomic_write(path) as temporary, warnings.catch_warnings():
        # PyTorch's newer exporter makes the same graph in twenty times the time.
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


def onnx_difference(path: Path, trained: Trained) -> float:
    """Largest absolute difference of an ONNX file's outputs from those of the network.

    It is of three random inputs: another number than the file was written with.

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


def _example(trained: Trained, count: int = 2) -> dict[str, Any]:
    """Random inputs [n 3 s s] from 0 to 1."""
    size = trained.learner.size
    chance = rng.stream(0, "learn/onnx", count)
    return {
        name: chance.random((count, 3, size, size), dtype=np.float32)
        for name in trained.learner.input_names
    }
