"""Transmission of actions and images: delay, dropout and quantization, in every environment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from vrcaps.core import rng
from vrcaps.core.errors import InputError
from vrcaps.core.fields import Range, check_fields
from vrcaps.env.observations import ImageObservation

if TYPE_CHECKING:
    from vrcaps.env.parts import Observation
    from vrcaps.env.worlds import Memory

_MAX_DELAY = 64
_KEY = "transmission/{}"


@dataclass(frozen=True)
class Transmission:
    """Delay, dropout and quantization of actions and images.

    Example:
        >>> radio = Transmission(action_delay=1, image_delay=2, image_dropout=0.1, image_levels=64)
        >>> settings = EnvSettings(transmission=radio)

    Attributes:
        action_delay: Delay of actions in control periods; until the first arrives, an action of
            zeros is applied.
        action_dropout: Probability that an action is lost; the last one received stays in effect.
        action_levels: Number of levels of each value of an action, over its range; None is exact.
        image_delay: Delay of images in control periods; until then the first image is shown.
        image_dropout: Probability that an image is lost; the last one received is shown.
        image_levels: Number of levels of each value of an image, over its range; None is exact.
    """

    action_delay: Annotated[int, Range(min=0, max=_MAX_DELAY)] = 0
    action_dropout: Annotated[float, Range(min=0.0, below=1.0)] = 0.0
    action_levels: Annotated[int | None, Range(min=2, max=2**16)] = None
    image_delay: Annotated[int, Range(min=0, max=_MAX_DELAY)] = 0
    image_dropout: Annotated[float, Range(min=0.0, below=1.0)] = 0.0
    image_levels: Annotated[int | None, Range(min=2, max=2**16)] = None

    def __post_init__(self) -> None:
        check_fields(self)


class Link:
    """Queues of a transmission in all worlds. Their state is part of the environment's memory."""

    def __init__(
        self,
        settings: Transmission,
        memory: Memory,
        action_space: Any,
        observations: Sequence[Observation],
        observation_space: Any,
    ) -> None:
        """Allocate the queues that the settings need.

        Raises:
            InputError: If actions with levels are choices.
        """
        self._settings, self._memory, self._space = settings, memory, action_space
        if settings.action_levels is not None and not hasattr(action_space, "low"):
            raise InputError(
                "action_levels is given, but the actions are choices. Allowed: None, or an "
                "actuation with continuous actions."
            )
        self._has_actions = settings.action_delay > 0 or settings.action_dropout > 0.0
        self._spaces = {o.name: observation_space[o.name] for o in observations if _is_image(o)}
        self._has_images = bool(self._spaces) and (
            settings.image_delay > 0 or settings.image_dropout > 0.0
        )
        if self._has_actions:
            shape = (settings.action_delay + 1, *action_space.shape)
            memory.allocate(_KEY.format("sent"), shape, action_space.dtype)
            memory.allocate(_KEY.format("acting"), action_space.shape, action_space.dtype)
        if self._has_images:
            for name, space in self._spaces.items():
                queue = (settings.image_delay + 1, *space.shape)
                memory.allocate(_KEY.format(f"queue/{name}"), queue, space.dtype)
                memory.allocate(_KEY.format(f"shown/{name}"), space.shape, space.dtype)
                memory.allocate(_KEY.format(f"count/{name}"), dtype=np.int64, fill=-1)
        if self._has_actions or self._has_images:
            memory.allocate(_KEY.format("seed"), dtype=np.int64)
            memory.allocate(_KEY.format("step"), dtype=np.int64)

    def begin(self, index: int, generator: np.random.Generator) -> None:
        """Empty the queues of one world."""
        if not (self._has_actions or self._has_images):
            return
        memory = self._memory
        memory[_KEY.format("seed")][index] = generator.integers(2**31)
        memory[_KEY.format("step")][index] = 0
        if self._has_actions:
            memory[_KEY.format("sent")][index] = memory[_KEY.format("acting")][index] = 0
        for name in self._spaces if self._has_images else ():
            memory[_KEY.format(f"count/{name}")][index] = -1

    def send(self, actions: np.ndarray, active: np.ndarray) -> np.ndarray:
        """Return the actions applied in the active worlds, given those sent."""
        settings, memory = self._settings, self._memory
        if settings.action_levels is not None:
            low, high = self._space.low, self._space.high
            actions = _quantized(np.asarray(actions, float), low, high, settings.action_levels)
        if self._has_actions or self._has_images:
            memory[_KEY.format("step")][active] += 1
        if not self._has_actions:
            return actions
        sent, acting = memory[_KEY.format("sent")], memory[_KEY.format("acting")]
        sent[active] = np.roll(sent[active], 1, axis=1)
        sent[active, 0] = actions[active]
        for index in np.flatnonzero(active).tolist():
            if not self._is_lost(index, "action", settings.action_dropout):
                acting[index] = sent[index, -1]
        return np.where(_expanded(active, acting), acting, actions)

    def receive(self, observations: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return observations whose images have been transmitted; the same until the next step."""
        levels = self._settings.image_levels
        for name, space in self._spaces.items():
            images = observations[name]
            if levels is not None:
                images = _quantized(images, space.low, space.high, levels)
            if self._has_images:
                images = self._queued(name, images)
            observations[name] = images
        return observations

    def _queued(self, name: str, images: np.ndarray) -> np.ndarray:
        memory, dropout = self._memory, self._settings.image_dropout
        queue, shown = (memory[_KEY.format(f"{part}/{name}")] for part in ("queue", "shown"))
        counts, steps = memory[_KEY.format(f"count/{name}")], memory[_KEY.format("step")]
        for index in np.flatnonzero(counts != steps).tolist():
            if counts[index] < 0:
                queue[index] = shown[index] = images[index]
            else:
                queue[index] = np.roll(queue[index], 1, axis=0)
                queue[index, 0] = images[index]
                if not self._is_lost(index, "image", dropout):
                    shown[index] = queue[index, -1]
            counts[index] = steps[index]
        return shown.copy()

    def _is_lost(self, index: int, what: str, dropout: float) -> bool:
        """Whether a packet of the current step is lost; the same for all images of a world."""
        if not dropout:
            return False
        seed, step = (int(self._memory[_KEY.format(name)][index]) for name in ("seed", "step"))
        return bool(rng.stream(seed, f"transmission/{what}/{step}").random() < dropout)


def _is_image(observation: Observation) -> bool:
    return isinstance(observation, ImageObservation)


def _expanded(active: np.ndarray, like: np.ndarray) -> np.ndarray:
    return active.reshape(-1, *(1,) * (like.ndim - 1))


def _quantized(values: np.ndarray, low: Any, high: Any, levels: int) -> np.ndarray:
    """Values rounded to evenly spaced levels from low to high, of the same type."""
    step = (np.asarray(high, float) - low) / (levels - 1)
    rounded = low + step * np.rint((values - np.asarray(low, float)) / step)
    if values.dtype.kind in "ui":
        rounded = np.rint(rounded)
    return rounded.astype(values.dtype)
