"""Effects on what is seen: the wet film on the wall, and the camera's geometry."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.camera.derive import barrel_lens, barrel_radius, scaled_lens
from vrcaps.errors import InputError, require

if TYPE_CHECKING:
    from vrcaps.camera.camera import Camera
    from vrcaps.organ.surface import OrganSurface

_FEWEST_PX = 8


@dataclass(frozen=True)
class Film:
    """How the wall mirrors the LEDs, in place of the organ's own.

    Attributes:
        coat: Strength of the wet film, 0 (dry) to 1 (whole).
        gloss: Gloss of the wet film, 0 (satin) to 1 (mirror-like).
        ior: Refractive index of the wall under it, 1 (no reflection) or more.
    """

    coat: float
    gloss: float = 0.93
    ior: float = 1.4

    def __post_init__(self) -> None:
        require(0.0 <= self.coat <= 1.0, "Film's coat", self.coat, "0 to 1")
        require(0.0 <= self.gloss <= 1.0, "Film's gloss", self.gloss, "0 to 1")
        require(1.0 <= self.ior < 3.0, "Film's ior", self.ior, "1 to below 3")

    def on(self, organ: OrganSurface) -> OrganSurface:
        """The organ with this film.

        Raises:
            InputError: If the organ has no appearance.
        """
        if organ.appearance is None:
            raise InputError(f"{organ.name} has no look of its own, so no specular reflection.")
        look = replace(
            organ.appearance, clearcoat=self.coat, clearcoat_gloss=self.gloss, ior=self.ior
        )
        return replace(organ, appearance=look)


@dataclass(frozen=True)
class Distortion:
    """Barrel distortion beyond that of the camera's own lens: the middle bulges, the edge stays.

    Attributes:
        inward: Share by which the image radius at the image's nearest edge is smaller than the
            scale in the middle would have it.
    """

    inward: float

    def __post_init__(self) -> None:
        require(0.0 <= self.inward < 0.5, "Distortion's inward", self.inward, "0 to below 0.5")

    def on(self, camera: Camera) -> Camera:
        """The camera with such a lens."""
        edge = half_side_px(camera)
        lens = barrel_lens(camera.lens, self.inward, edge)
        circle = camera.image_circle_px
        if circle is not None:
            circle = float(barrel_radius(np.array(circle), self.inward, edge))
        return replace(camera, lens=lens, image_circle_px=circle)


@dataclass(frozen=True)
class FieldOfView:
    """A longer lens on the same sensor.

    Attributes:
        magnification: Factor on the focal length; above 1 the camera sees less.
    """

    magnification: float

    def __post_init__(self) -> None:
        magnification = self.magnification
        is_valid = 0.1 <= magnification <= 10.0
        require(is_valid, "FieldOfView's magnification", magnification, "0.1 to 10")

    def on(self, camera: Camera) -> Camera:
        """The camera with such a lens."""
        lens, scale, circle = camera.lens, self.magnification, camera.image_circle_px
        return replace(
            camera,
            lens=scaled_lens(lens, scale, (lens.cx, lens.cy)),
            image_circle_px=None if circle is None else circle * scale,
        )


@dataclass(frozen=True)
class Resolution:
    """A sensor of the same size with fewer and larger pixels.

    Attributes:
        scale: Pixels to a side, relative to the camera's own.
    """

    scale: float

    def __post_init__(self) -> None:
        require(0.0 < self.scale <= 4.0, "Resolution's scale", self.scale, "above 0 to 4")

    def on(self, camera: Camera) -> Camera:
        """The camera with such a sensor.

        Raises:
            InputError: If hardly a pixel is left.
        """
        return scaled_camera(camera, self.scale)


def scaled_camera(camera: Camera, scale: float) -> Camera:
    """The camera with another number of pixels to a side; a rest below one pixel is rounded.

    Raises:
        InputError: If hardly a pixel is left.
    """
    width, height = (round(size * scale) for size in (camera.width, camera.height))
    if min(width, height) < _FEWEST_PX:
        raise InputError(
            f"{camera.width} x {camera.height} pixels times {scale:g} are {width} x {height}. "
            f"Allowed: {_FEWEST_PX} or more to a side."
        )
    lens, circle = camera.lens, camera.image_circle_px
    center = ((lens.cx + 0.5) * scale - 0.5, (lens.cy + 0.5) * scale - 0.5)
    return replace(
        camera,
        lens=scaled_lens(lens, scale, center),
        width=width,
        height=height,
        image_circle_px=None if circle is None else circle * scale,
    )


def half_side_px(camera: Camera) -> float:
    """Half the shorter side of the image [px]."""
    return 0.5 * min(camera.width, camera.height)
