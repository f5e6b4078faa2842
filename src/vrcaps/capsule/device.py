"""A capsule endoscope as data: body, cameras with their lenses, LEDs, magnets."""

from __future__ import annotations

from dataclasses import dataclass, field

from vrcaps.camera.camera import Camera
from vrcaps.errors import UnknownNameError
from vrcaps.magnet.internal import InternalMagnet


@dataclass(frozen=True)
class Device:
    """A capsule endoscope.

    Its frame `capsule` has its origin at the centre of mass and +z along the front camera's axis.

    Attributes:
        name: Catalog name.
        title: Full name for people.
        length: Overall length [m].
        radius: Radius of the cylindrical body with round ends [m].
        mass: Mass [kg].
        frame_rate: Frames per second of each camera.
        cameras: Its cameras.
        magnets: Magnets in it.
        led_spectrum: Wavelengths [nm], rising, and relative power of its white LEDs; linear between
            them, nothing beyond. None is a blue LED under a yellow phosphor.
        source: Where the figures come from.
        metadata: Further plain facts, kept with the device and used by nothing.
    """

    name: str
    title: str
    length: float
    radius: float
    mass: float
    frame_rate: float
    cameras: tuple[Camera, ...]
    magnets: tuple[InternalMagnet, ...] = ()
    led_spectrum: tuple[tuple[float, float], ...] | None = None
    source: str = ""
    metadata: dict = field(default_factory=dict)

    def camera(self, name: str) -> Camera:
        """A camera by its name.

        Raises:
            UnknownNameError: If the capsule has no such camera.
        """
        for camera in self.cameras:
            if camera.name == name:
                return camera
        raise UnknownNameError("camera", name, [camera.name for camera in self.cameras])
