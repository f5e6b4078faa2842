"""Checkpoints: fp16 safetensors files with metadata."""

from __future__ import annotations

import json
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from vrcaps import __version__
from vrcaps.config.convert import from_plain, to_plain
from vrcaps.core.errors import InputError, MissingExtraError, VrcapsError, import_extra, reading
from vrcaps.core.files import atomic_write
from vrcaps.learn.networks import require_torch
from vrcaps.learn.registry import LEARNERS, AnyTask
from vrcaps.training.threads import exact_torch

_FORMAT, _KEY = "vrcaps-weights/1", "vrcaps"


@dataclass(frozen=True)
class TrainedNetwork:
    """A learner with its trained network, ready for prediction.

    Attributes:
        learner: The task and its settings.
        network: Network on the device, in evaluation mode.
        about: Metadata of the file: steps, metrics, data.
        device: Device of the computation.
        threads: PyTorch threads on a CPU; more than one is slower on a machine with other load.
            None keeps the current setting.
    """

    learner: AnyTask
    network: Any
    about: dict[str, Any]
    device: str = "cpu"
    threads: int | None = 1

    def __call__(self, inputs: dict[str, Any]) -> np.ndarray:
        """Return the outputs [b …] for a batch of inputs."""
        with self._threads(), require_torch().inference_mode():
            given = (inputs[name].to(self.device) for name in self.learner.input_names)
            return self.network(*given).float().cpu().numpy()

    def loss(self, batch: dict[str, Any]) -> float:
        """Return the learner's loss on a batch."""
        with self._threads(), require_torch().inference_mode():
            return float(self.learner.loss(self.network, batch)["loss"])

    def _threads(self) -> AbstractContextManager[None]:
        if self.threads is None or self.device != "cpu":
            return nullcontext()
        return exact_torch(self.threads)


def write_weights(path: Path, learner: AnyTask, network: Any, about: dict[str, Any]) -> None:
    """Write a network's weights atomically.

    Args:
        path: File to write, `.safetensors`.
        learner: Its task and settings.
        network: Network; its weights are rounded to 16 bits.
        about: Metadata: steps, metrics, data.

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
        "task": learner.kind,
        "learner": to_plain(learner, type(learner)),
        "about": about,
    }
    # One key, since safetensors writes several in no defined order.
    metadata = {_KEY: json.dumps(stated, sort_keys=True)}
    with atomic_write(path) as temporary:
        save_file(tensors, str(temporary), metadata=metadata)


def read_weights(
    path: str | Path, *, task: str | None = None, device: str = "cpu"
) -> TrainedNetwork:
    """Read weights that `write_weights` wrote.

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
    if stated.get("format") != _FORMAT or not isinstance(kind, str) or kind not in LEARNERS:
        raise InputError(f"{path} holds no weights of vrcaps.")
    if task is not None and kind != task:
        raise InputError(f"{path} holds weights of the task {kind!r}. Asked for: {task!r}.")
    about = stated.get("about")
    if not isinstance(about, dict):
        raise InputError(f"{path} does not say what its weights are of: about is no table.")
    try:
        learner = from_plain(LEARNERS[kind], stated.get("learner"), at=str(path))
        network = _network_of(learner, tensors)
    except MissingExtraError:
        raise
    except (VrcapsError, LookupError, ValueError, RuntimeError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(f"{path} does not fit this version of vrcaps: {reason}") from error
    return TrainedNetwork(learner, network.to(device).eval(), about, device)


def _read_file(path: str | Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Read the metadata and the tensors of a file, all finite.

    Raises:
        InputError: If it cannot be read, or a value is not finite.
        MissingExtraError: If a package is not installed.
    """
    safe_open, torch = import_extra("safetensors", "learn").safe_open, require_torch()
    with reading(path), safe_open(str(path), framework="pt") as file:
        stated = json.loads((file.metadata() or {}).get(_KEY, "{}"))
        stored = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    # Narrowed before they are checked: 64-bit numbers may exceed those of 32 bits.
    tensors = {k: v.float() if v.is_floating_point() else v for k, v in stored.items()}
    for name, tensor in tensors.items():
        if tensor.is_floating_point() and not torch.isfinite(tensor).all():
            raise InputError(f"{path} holds numbers that are not finite, in {name}.")
    return stated if isinstance(stated, dict) else {}, tensors


def _network_of(learner: AnyTask, tensors: dict[str, Any]) -> Any:
    """Create a learner's network with the given weights; shapes are compared before allocation.

    Raises:
        InputError: If the weights are of another network.
    """
    torch = require_torch()
    with torch.device("meta"), torch.random.fork_rng(devices=[]):
        outline = learner.network(is_pretrained=False).state_dict()
    expected, found = ({k: tuple(v.shape) for k, v in s.items()} for s in (outline, tensors))
    wrong = sorted(k for k in {*expected, *found} if expected.get(k) != found.get(k))
    if wrong:
        name = wrong[0]
        raise InputError(
            f"{len(wrong)} weights do not fit the network that it states, such as {name}: "
            f"{found.get(name, 'missing')}, not {expected.get(name, 'known')}"
        )
    for name, value in tensors.items():
        if value.is_floating_point() != outline[name].is_floating_point() or value.is_complex():
            raise InputError(f"{name} has numbers of type {value.dtype}, not {outline[name].dtype}")
    network = learner.network(is_pretrained=False)
    network.load_state_dict(tensors)
    return network
