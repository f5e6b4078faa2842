"""A capsule endoscope as data: body, cameras with their lenses, LEDs, magnets."""

from __future__ import annotations

from dataclasses import dataclass, field

from vrcaps.camera.camera import Camera
from vrcaps.errors import UnknownNameError
from vrcaps.magnet.internal import InternalMagnet


@dataclass(frozen=True, kw_only=True)
class Device:
    """A capsule endoscope.

    Its frame `capsule` has its origin at the centre of mass and +z along the front camera's axis.

    Example:
        >>> lens = vrcaps.LensEquidistant(focal=84.0, cx=127.5, cy=127.5)
        >>> T_capsule_camera = vrcaps.translation(0.0, 0.0, 7e-3)
        >>> leds = vrcaps.led_ring(4, radius=3.5e-3)
        >>> camera = vrcaps.Camera("front", lens, 256, 256, T_capsule_camera, leds)
        >>> device = vrcaps.Device(length=24e-3, radius=5.5e-3, mass=3e-3, cameras=(camera,))

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

    name: str = "custom"
    title: str = ""
    length: float
    radius: float
    mass: float
    frame_rate: float = 2.0
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
