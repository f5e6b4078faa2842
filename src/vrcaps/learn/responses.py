"""Dependence of a network's outputs on its inputs, by a few synthetic probes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.capsule.device_file import read_device
from vrcaps.core import rng
from vrcaps.core.errors import InputError
from vrcaps.learn.checkpoint import TrainedNetwork
from vrcaps.learn.letterbox import Letterbox
from vrcaps.learn.samples import batch_of
from vrcaps.learn.task import Sample

if TYPE_CHECKING:
    from jaxtyping import Float, UInt8

MIN_RESPONSE = 0.01
"""Minimum change of each output, relative to its root mean square. Outputs of the published
networks change by 0.05 or more between the probes."""
_ROUNDING = 1e-5
"""Root mean square below which an output is 0 up to rounding, and its changes do not count."""
_BY_IMAGE = " by image"
_SIDE = 256
_COLORS = ((180.0, 90.0, 70.0), (90.0, 60.0, 50.0), (200.0, 150.0, 130.0), (120.0, 60.0, 40.0))
_WAVELENGTHS = (0.5, 0.2, 0.05, 0.3)
_CAPSULES = ("pillcam-colon2", "mono", "panoramic", "mirocam")


def responses(trained: TrainedNetwork, samples: Sequence[Sample]) -> dict[str, float]:
    """Change of each output between samples, relative to its root mean square.

    One input changes at a time; the others are those of the first sample.

    Args:
        trained: Task and network.
        samples: Two or more inputs of the network, as `Task.inputs` returns them.

    Returns:
        The change by the name of the output, its channel and the input, such as
        ``output 0 by image``.
    """
    batch = batch_of(samples, trained.device)
    result: dict[str, float] = {}
    for name in trained.task.input_names:
        first = {key: value[:1].expand_as(value) for key, value in batch.items()}
        for output, values in trained.outputs({**first, name: batch[name]}).items():
            changes = _changes(values)
            result |= {f"{output} {k} by {name}": float(one) for k, one in enumerate(changes)}
    return result


def constant_outputs(trained: TrainedNetwork) -> dict[str, float]:
    """Outputs that do not depend on the image, with their change between probes."""
    return {
        name.removesuffix(_BY_IMAGE): change
        for name, change in responses(trained, probes(trained)).items()
        if name.endswith(_BY_IMAGE) and not change > MIN_RESPONSE
    }


def require_responses(trained: TrainedNetwork) -> None:
    """Check that each output of a network depends on its image.

    Raises:
        InputError: If an output is the same for all images.
    """
    for name, change in constant_outputs(trained).items():
        raise InputError(
            f"The network of the task {trained.task.kind!r} gives the same output for all "
            f"images: {name} changes by {change:.2g} of its size. "
            f"Allowed: above {MIN_RESPONSE:g}. Train it for longer."
        )


def probes(trained: TrainedNetwork) -> list[Sample]:
    """Inputs of a network that differ in color, pattern and lens; the same on every run."""
    fit = Letterbox(_SIDE, _SIDE, trained.task.input_size)
    cameras = [read_device(name).cameras[0] for name in _CAPSULES]
    return [
        trained.task.inputs(_probe(k), fit, replace(camera, width=_SIDE, height=_SIDE))
        for k, camera in enumerate(cameras)
    ]


def _probe(index: int) -> UInt8[np.ndarray, "s s 3"]:
    """Image of a color modulated by waves in random directions."""
    draw = rng.stream(index, "learn/probe")
    position = np.stack(np.meshgrid(*2 * [np.linspace(0.0, 1.0, _SIDE)]), axis=-1)
    waves = draw.normal(size=(8, 2)) / _WAVELENGTHS[index]
    pattern = np.cos(2.0 * np.pi * (position @ waves.T) + draw.uniform(0.0, 2.0 * np.pi, 8))
    bright = 1.0 + 0.15 * pattern.sum(axis=-1)
    return np.clip(bright[..., None] * _COLORS[index], 0, 255).astype(np.uint8)


def _changes(values: Float[np.ndarray, "b c ..."]) -> Float[np.ndarray, " c"]:
    """Standard deviation over a batch, relative to the root mean square of the values."""
    flat = values.reshape(*values.shape[:2], -1).astype(float)
    change = np.sqrt(((flat - flat.mean(axis=0)) ** 2).mean(axis=(0, 2)))
    return change / np.maximum(np.sqrt((flat**2).mean(axis=(0, 2))), _ROUNDING)
