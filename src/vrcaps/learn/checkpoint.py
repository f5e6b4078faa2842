"""Checkpoints: fp16 safetensors files with metadata, and their export to ONNX."""

from __future__ import annotations

import json
import warnings
from contextlib import AbstractContextManager, nullcontext
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from vrcaps import __version__
from vrcaps.config.convert import from_plain, to_plain
from vrcaps.core import rng
from vrcaps.core.errors import InputError, MissingExtraError, VrcapsError, import_extra, reading
from vrcaps.core.files import atomic_write
from vrcaps.learn.registry import FORMER_TASKS, TASKS, current_settings
from vrcaps.learn.task import INPUTS, Batch, Task
from vrcaps.training import exact_torch

_FORMAT, _KEY = "vrcaps-weights/1", "vrcaps"
_OUTPUT = "output"


@dataclass(frozen=True)
class TrainedNetwork:
    """A task with its trained network, ready for prediction.

    Attributes:
        task: The task and its settings.
        network: Network on the device, in evaluation mode.
        metadata: Metadata of the file: steps, metrics, data.
        device: Device of the computation.
        threads: PyTorch threads on a CPU; more than one is slower on a machine with other load.
            None keeps the current setting.
    """

    task: Task
    network: nn.Module
    metadata: dict[str, Any]
    device: str = "cpu"
    threads: int | None = 1

    def __call__(self, inputs: Batch) -> np.ndarray:
        """Return the outputs [b …] for a batch of inputs."""
        with self._threads(), torch.inference_mode():
            names = (*self.task.input_names, *self.task.optional_inputs)
            given = {name: inputs[name].to(self.device) for name in names if name in inputs}
            return self.task.output(self.network, given).cpu().numpy()

    def outputs(self, batch: Batch) -> dict[str, np.ndarray]:
        """Return all outputs [b c …] of the network, by name."""
        with self._threads(), torch.inference_mode():
            outputs = self.task.outputs(self.network, batch)
        return {name: value.cpu().numpy() for name, value in outputs.items()}

    def loss(self, batch: Batch) -> float:
        """Return the task's loss on a batch."""
        with self._threads(), torch.inference_mode():
            return float(self.task.loss(self.network, batch)["loss"])

    def _threads(self) -> AbstractContextManager[None]:
        if self.threads is None or self.device != "cpu":
            return nullcontext()
        return exact_torch(self.threads)


def write_weights(path: Path, task: Task, network: nn.Module, metadata: dict[str, Any]) -> None:
    """Write a network's weights atomically.

    Args:
        path: File to write, `.safetensors`.
        task: Its task and settings.
        network: Network; its weights are rounded to 16 bits.
        metadata: Metadata: steps, metrics, data.

    Raises:
        MissingExtraError: If safetensors is not installed.
    """
    save_file = import_extra("safetensors.torch", "learn", package="safetensors").save_file
    tensors = {
        name: (value.half() if value.is_floating_point() else value).cpu().contiguous()
        for name, value in network.state_dict().items()
    }
    stated = {
        "format": _FORMAT,
        "vrcaps": __version__,
        "task": task.kind,
        "learner": to_plain(task, type(task)),
        "about": metadata,
    }
    # One key, since safetensors writes several in no defined order.
    header = {_KEY: json.dumps(stated, sort_keys=True)}
    with atomic_write(path) as temporary:
        save_file(tensors, str(temporary), metadata=header)


def read_weights(
    path: str | Path, *, task: str | None = None, device: str = "cpu"
) -> TrainedNetwork:
    """Read weights that `write_weights` of this or an older version wrote.

    Args:
        path: The file.
        task: Required task; None for any.
        device: Device of the network.

    Raises:
        InputError: If the file is damaged, is not a weights file, is of another task, holds a value
            that is not finite, or does not fit the network that it states.
        MissingExtraError: If a package is not installed.
    """
    stated, tensors = _read_file(path)
    kind = stated.get("task")
    kind = FORMER_TASKS.get(kind, kind) if isinstance(kind, str) else ""
    if stated.get("format") != _FORMAT or kind not in TASKS:
        raise InputError(f"{path} contains no weights of vrcaps.")
    if task is not None and kind != task:
        raise InputError(f"{path} contains weights of the task {kind!r}. Required: {task!r}.")
    metadata = stated.get("about")
    if not isinstance(metadata, dict):
        raise InputError(f"{path} has no metadata of its training: 'about' is not a table.")
    try:
        cls = TASKS[kind]
        settings = current_settings(cls, stated.get("learner"))
        network_task: Task = from_plain(cls, settings, at=str(path))
        network = _network_of(network_task, tensors)
    except MissingExtraError:
        raise
    except (VrcapsError, LookupError, ValueError, RuntimeError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(f"{path} does not fit this version of vrcaps: {reason}") from error
    return TrainedNetwork(network_task, network.to(device).eval(), metadata, device)


def _read_file(path: str | Path) -> tuple[dict[str, Any], dict[str, Tensor]]:
    """Read the metadata and the tensors of a file, all finite.

    Raises:
        InputError: If it cannot be read, or a value is not finite.
        MissingExtraError: If a package is not installed.
    """
    safe_open = import_extra("safetensors", "learn").safe_open
    with reading(path), safe_open(str(path), framework="pt") as file:
        stated = json.loads((file.metadata() or {}).get(_KEY, "{}"))
        stored = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    # Narrowed before they are checked: 64-bit numbers may exceed those of 32 bits.
    tensors = {k: v.float() if v.is_floating_point() else v for k, v in stored.items()}
    for name, tensor in tensors.items():
        if tensor.is_floating_point() and not torch.isfinite(tensor).all():
            raise InputError(f"{path} contains values that are not finite, in {name}.")
    return stated if isinstance(stated, dict) else {}, tensors


def _network_of(task: Task, tensors: dict[str, Tensor]) -> nn.Module:
    """Create a task's network with the given weights; it is never initialized at random.

    Raises:
        InputError: If the weights are of another network.
    """
    with torch.device("meta"), torch.random.fork_rng(devices=[]):
        network = task.network(is_pretrained=False)
    outline = network.state_dict()
    expected, given = ({k: tuple(v.shape) for k, v in s.items()} for s in (outline, tensors))
    wrong = sorted(k for k in {*expected, *given} if expected.get(k) != given.get(k))
    if wrong:
        name = wrong[0]
        raise InputError(
            f"{len(wrong)} weights do not fit the stated network, such as {name}: "
            f"{given.get(name, 'missing')}, not {expected.get(name, 'known')}"
        )
    for name, value in tensors.items():
        if value.is_floating_point() != outline[name].is_floating_point() or value.is_complex():
            raise InputError(f"{name} has values of type {value.dtype}, not {outline[name].dtype}")
    network.load_state_dict(tensors, assign=True)
    return network


def write_onnx(path: Path, trained: TrainedNetwork) -> None:
    """Write a trained network as ONNX atomically.

    The batch size is dynamic. For super-resolution the image size is dynamic as well, but for
    attention-unet both sides must be divisible by 2 per level. The file's metadata hold the task,
    its settings, and the inputs and outputs.

    Args:
        path: File to write.
        trained: Task and network; for `sfm`, the distance network is exported.

    Raises:
        MissingExtraError: If onnx is not installed.
    """
    onnx, task = import_extra("onnx", "learn"), trained.task
    with atomic_write(path) as temporary, warnings.catch_warnings():
        # PyTorch's newer exporter creates the same graph but takes twenty times as long.
        warnings.simplefilter("ignore")
        torch.onnx.export(
            deepcopy(trained.network).cpu().eval(),
            tuple(torch.from_numpy(one) for one in _example(trained).values()),
            str(temporary),
            dynamo=False,
            input_names=list(task.input_names),
            output_names=[_OUTPUT],
            dynamic_axes={name: dict(task.free_axes) for name in (*task.input_names, _OUTPUT)},
        )
        model = onnx.load(temporary)
        stated = {
            "task": task.kind,
            "learner": json.dumps(to_plain(task, type(task)), sort_keys=True),
            **{name: INPUTS.get(name, "") for name in task.input_names},
            _OUTPUT: task.output_text,
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
    (output,) = session.run([_OUTPUT], given)
    expected = trained({name: torch.from_numpy(one) for name, one in given.items()})
    return float(np.abs(output - expected).max())


def _example(trained: TrainedNetwork, count: int = 2) -> dict[str, np.ndarray]:
    """Random inputs [n 3 s s] between 0 and 1."""
    size = trained.task.input_size
    draw = rng.stream(0, "learn/onnx", count)
    return {
        name: draw.random((count, 3, size, size), dtype=np.float32)
        for name in trained.task.input_names
    }
