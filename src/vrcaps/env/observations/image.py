"""Image observation: one channel of a camera of the capsule."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from vrcaps.core.errors import UnknownNameError, require
from vrcaps.env.cameras import View
from vrcaps.env.parts import EnvView, Observation
from vrcaps.render.channels import CHANNELS
from vrcaps.render.settings import RenderSettings

LIMITS: dict[str, tuple[float, float]] = {
    "rgb": (0, 255),
    "depth": (0.0, 1.0),
    "ray_distance": (0.0, 1.0),
    "normal": (-1.0, 1.0),
    "albedo": (0.0, 1.0),
    "label": (0, 255),
    "instance": (0, 65535),
    "arc_length": (0.0, 20.0),
}
"""Channels that can be observed, with the limits of their values."""


@dataclass(frozen=True)
class ImageObservation(Observation):
    """One channel of a camera's image [h w c].

    Colors are uint8, as learning libraries expect images to be; other channels keep their units and
    are 0 where no wall is visible. Several channels are several observations, which are rendered
    together if camera, size and settings are the same.

    Example:
        >>> color = ImageObservation("rgb", size=(48, 48))
        >>> depth = ImageObservation("depth", size=(48, 48))
        >>> settings = EnvSettings(observations=(color, depth))

    Attributes:
        channel: One of `LIMITS`, see `Frame` for their contents.
        camera: Name of the camera; None for the capsule's first.
        size: Height and width [px]. The camera's image is scaled to cover this size, then cropped.
        render: Render settings.
        key: Name of the observation; None for the channel's.
    """

    channel: str = "rgb"
    camera: str | None = None
    size: tuple[int, int] = (64, 64)
    render: RenderSettings = field(default_factory=lambda: RenderSettings(light="direct"))
    key: str | None = None

    kind: ClassVar[str] = "image"
    needs_textures: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if self.channel not in LIMITS:
            raise UnknownNameError("channel to observe", self.channel, LIMITS)
        size = tuple(self.size)
        is_size = len(size) == 2 and all(isinstance(n, int) and 8 <= n <= 4096 for n in size)
        require(is_size, "size", self.size, "height and width, 8 to 4096 pixels each")
        object.__setattr__(self, "size", size)

    @property
    def name(self) -> str:
        """Key of the observation."""
        return self.channel if self.key is None else self.key

    @property
    def view(self) -> View:
        """View that is rendered."""
        return View(self.camera, self.size, self.render)

    def space(self, view: EnvView) -> Any:
        """Observation space: images between the channel's limits."""
        from gymnasium import spaces

        shape = (*CHANNELS[self.channel].shape(*self.size), 1)[:3]
        return spaces.Box(*LIMITS[self.channel], shape, np.dtype(CHANNELS[self.channel].dtype))

    def names(self, view: EnvView) -> tuple[str, ...]:
        """Name of each channel of the image, with its unit in brackets."""
        count, unit = self.space(view).shape[-1], CHANNELS[self.channel].unit
        parts = "rgb" if self.channel in ("rgb", "albedo") else "xyz"
        stems = [f"{self.name}_{part}" for part in parts] if count == 3 else [self.name]
        return tuple(f"{stem} [{unit}]" for stem in stems)

    def allocate(self, view: EnvView) -> None:
        """Allocate the images."""
        view.cameras.request(self.view, self.channel)

    def observe(self, view: EnvView) -> np.ndarray:
        """Return the images of all worlds [n h w c]."""
        images = view.cameras.images(self.view, self.channel)
        images = images.copy() if images.ndim == 4 else images[..., None].copy()
        if images.dtype.kind == "f":
            np.clip(np.nan_to_num(images, copy=False), *LIMITS[self.channel], out=images)
        return images
