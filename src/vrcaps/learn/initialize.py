"""Weight initialization: random, ImageNet, or a checkpoint."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from pathlib import Path

from torch import Tensor, nn

from vrcaps.core.errors import InputError
from vrcaps.learn.checkpoint import TrainedNetwork, read_weights
from vrcaps.learn.hub import find_weights
from vrcaps.learn.networks import ENCODER, with_inputs
from vrcaps.learn.settings import IMAGENET, SCRATCH
from vrcaps.learn.task import Task

_DENSE, _WHOLE = "net.encoder.model.", "net."
"""Prefixes of the encoder's parameter names in dense networks and in classifiers."""


def initialized_network(task: Task, start: str) -> nn.Module:
    """Create a network and initialize its weights.

    From a checkpoint of the same task, all parameters of the same shape are copied; of the last
    layer, the rows of the classes that both have, by name. Classes missing from the checkpoint are
    initialized from the task's fallback class, if the checkpoint has it: for segmentation, that of
    any lesion. A checkpoint of a similar task counts as one of the same task: `sfm` starts with the
    network of `depth`. From a checkpoint of another task, the encoder is copied. The rest of a
    network is then initialized from ImageNet weights if the checkpoint was, and if these weights
    need no download.

    Args:
        task: The task and its settings.
        start: `scratch`, `imagenet`, a checkpoint file, or the name of published weights.

    Raises:
        InputError: If there are no such weights, or they have no part for this task.
    """
    if start in (SCRATCH, IMAGENET):
        return task.network(is_pretrained=start == IMAGENET)
    path = find_weights(start)
    trained = read_weights(path)
    is_same_task = trained.task.kind in (task.kind, *task.similar_tasks)
    is_known = task.encoder == ENCODER and _origin(trained) == IMAGENET
    network = task.network(is_pretrained=is_known and not is_same_task)
    own = network.state_dict()
    known = _own_classes(trained, task, own) if is_same_task else _encoder(trained, task, own, path)
    network.load_state_dict(
        {k: v for k, v in known.items() if k in own and own[k].shape == v.shape}, strict=False
    )
    return network


def mean_with_start(network: nn.Module, start: Mapping[str, Tensor], fraction: float) -> nn.Module:
    """Copy of a network with the mean of its parameters and those at the start of its training.

    The mean often keeps more of the accuracy of the start on other data than the network does
    (Wortsman et al., Robust fine-tuning of zero-shot models, CVPR 2022).

    Args:
        network: Trained network.
        start: State of the network before the training.
        fraction: Fraction of the trained parameters in the mean, 0 to 1.
    """
    averaged = copy.deepcopy(network)
    state = averaged.state_dict()
    averaged.load_state_dict(
        {
            name: fraction * value + (1.0 - fraction) * start[name]
            if value.is_floating_point()
            else value
            for name, value in state.items()
        }
    )
    return averaged


def origin(start: str) -> str:
    """Original initialization of a start, `scratch` or `imagenet`, through all fine-tuning.

    Empty if the checkpoint does not state it.

    Raises:
        InputError: If there are no such weights.
    """
    if start in (SCRATCH, IMAGENET):
        return start
    return _origin(read_weights(find_weights(start)))


def _origin(trained: TrainedNetwork) -> str:
    return str(trained.metadata.get("origin", ""))


def _own_classes(trained: TrainedNetwork, task: Task, own: dict[str, Tensor]) -> dict[str, Tensor]:
    """State of a network trained on the same task, with the last layer for a task's classes."""
    known = trained.network.state_dict()
    theirs, ours = (getattr(one, "classes", ()) for one in (trained.task, task))
    if theirs == ours:
        return known
    sources = [name if name in theirs else task.fallback_class for name in ours]
    to = [k for k, name in enumerate(sources) if name in theirs]
    of = [theirs.index(sources[k]) for k in to]
    for name in [*own][-2:]:  # weight and bias of the last layer
        rows = own[name].clone()
        rows[to] = known[name][of]
        known[name] = rows
    return known


def _encoder(
    trained: TrainedNetwork, task: Task, own: dict[str, Tensor], path: Path
) -> dict[str, Tensor]:
    """Parameters of a trained encoder by their names in a network of another task."""
    theirs, ours = trained.task.encoder, task.encoder
    if theirs is None or theirs != ours:
        raise InputError(
            f"{path} contains weights of the task {trained.task.kind!r} with {_named(theirs)}; "
            f"{task.kind!r} has {_named(ours)}. Allowed: weights of the same task, or of one with "
            "the same encoder."
        )
    state = trained.network.state_dict()
    before, after = _prefix(state), _prefix(own)
    encoder = {
        after + name.removeprefix(before): value
        for name, value in state.items()
        if name.startswith(before)
    }
    return {k: with_inputs(v, own[k]) if k in own else v for k, v in encoder.items()}


def _prefix(state: dict[str, Tensor]) -> str:
    return _DENSE if any(name.startswith(_DENSE) for name in state) else _WHOLE


def _named(encoder: str | None) -> str:
    return f"the encoder {encoder!r}" if encoder else "no encoder"
