"""Weight initialization: random, ImageNet, or a checkpoint."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from vrcaps.core.errors import InputError
from vrcaps.learn.checkpoint import TrainedNetwork, read_weights
from vrcaps.learn.hub import find_weights
from vrcaps.learn.networks import ENCODER, with_inputs
from vrcaps.learn.registry import AnyTask
from vrcaps.learn.tasks.segmentation import LESION, SegmentationTask

SCRATCH, IMAGENET = "scratch", "imagenet"
_DENSE, _WHOLE = "net.encoder.model.", "net."
"""Prefixes of the encoder's parameter names in dense networks and in classifiers."""


def initialized_network(learner: AnyTask, start: str) -> Any:
    """Create a network and initialize its weights.

    From a checkpoint of the same task, all parameters of the same shape are copied; of the last
    layer, the rows of the classes that both have, by name. Segmentation classes missing from the
    checkpoint are initialized from its `lesion` class, if it has one. From a checkpoint of another
    task, the encoder is copied. The rest of a network is then initialized from ImageNet weights if
    the checkpoint was, and if these weights need no hub.

    Args:
        learner: The task and its settings.
        start: `scratch`, `imagenet`, a checkpoint file, or the name of published weights.

    Raises:
        InputError: If there are no such weights, or they have no part for this task.
    """
    if start in (SCRATCH, IMAGENET):
        return learner.network(is_pretrained=start == IMAGENET)
    path = find_weights(start)
    trained = read_weights(path)
    is_same_task = trained.learner.kind == learner.kind
    is_known = getattr(learner, "encoder", None) == ENCODER and _origin(trained) == IMAGENET
    network = learner.network(is_pretrained=is_known and not is_same_task)
    own = network.state_dict()
    known = (
        _own_classes(trained, learner, own)
        if is_same_task
        else _encoder(trained, learner, own, path)
    )
    network.load_state_dict(
        {k: v for k, v in known.items() if k in own and own[k].shape == v.shape}, strict=False
    )
    return network


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
    return str(trained.about.get("origin", ""))


def _own_classes(trained: TrainedNetwork, learner: AnyTask, own: dict[str, Any]) -> dict[str, Any]:
    """State of a network trained on the same task, with the last layer for a learner's classes."""
    known = trained.network.state_dict()
    theirs, ours = (getattr(one, "classes", ()) for one in (trained.learner, learner))
    if theirs == ours:
        return known
    other = LESION if isinstance(learner, SegmentationTask) else ""
    sources = [name if name in theirs else other for name in ours]
    to = [k for k, name in enumerate(sources) if name in theirs]
    of = [theirs.index(sources[k]) for k in to]
    for name in [*own][-2:]:  # weight and bias of the last layer
        rows = own[name].clone()
        rows[to] = known[name][of]
        known[name] = rows
    return known


def _encoder(
    trained: TrainedNetwork, learner: AnyTask, own: dict[str, Any], path: Path
) -> dict[str, Any]:
    """Parameters of a trained encoder by their names in a network of another task."""
    encoders = [getattr(one, "encoder", None) for one in (trained.learner, learner)]
    if None in encoders or encoders[0] != encoders[1]:
        raise InputError(
            f"{path} holds weights of the task {trained.learner.kind!r} with "
            f"{_named(encoders[0])}; {learner.kind!r} has {_named(encoders[1])}. Allowed: weights "
            "of the same task, or of one with the same encoder."
        )
    state = trained.network.state_dict()
    theirs, ours = _prefix(state), _prefix(own)
    found = {
        ours + name.removeprefix(theirs): value
        for name, value in state.items()
        if name.startswith(theirs)
    }
    return {k: with_inputs(v, own[k]) if k in own else v for k, v in found.items()}


def _prefix(state: dict[str, Any]) -> str:
    return _DENSE if any(name.startswith(_DENSE) for name in state) else _WHOLE


def _named(encoder: str | None) -> str:
    return f"the encoder {encoder!r}" if encoder else "no encoder"
