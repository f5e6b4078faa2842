"""Device: a capsule endoscope as data, with its body, cameras, LEDs and magnets."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.camera.camera import Camera, camera_named, check_names
from vrcaps.capsule.image_chain import ImageChain
from vrcaps.core.errors import InputError, require
from vrcaps.core.fields import plain_fields
from vrcaps.magnet.sources import InternalMagnet

if TYPE_CHECKING:
    from jaxtyping import Float

MAX_FRAME_RATE = 1e4
"""Maximum frame rate of cameras [1/s]."""


@dataclass(frozen=True, kw_only=True)
class Device:
    """A capsule endoscope: a cylinder with round ends, its cameras and its magnets.

    The origin of its frame `capsule` is the center of mass; +z is along the front camera's axis.

    Example:
        >>> lens = vrcaps.LensEquidistant(focal=84.0, cx=127.5, cy=127.5)
        >>> leds = vrcaps.led_ring(4, radius=3.5e-3)
        >>> camera = vrcaps.Camera("front", lens, 256, 256, position=(0, 0, 7e-3), leds=leds)
        >>> device = vrcaps.Device(length=24e-3, radius=5.5e-3, mass=3e-3, cameras=(camera,))

    Attributes:
        length: Overall length [m].
        radius: Radius of the cylindrical body with round ends [m].
        mass: Mass [kg].
        cameras: Its cameras, one or more, inside the body.
        name: Catalog name.
        title: Full name for display.
        frame_rate: Frames per second of each camera; the maximum if it adapts.
        lowest_frame_rate: Minimum frames per second of a camera that adapts its frame rate to the
            motion of the image; None for a constant frame rate.
        auto_exposure: Whether the cameras expose automatically; otherwise each camera has its own
            fixed exposure.
        image_chain: Lens, sensor and image processor as built; None for an ideal lens and sensor.
        magnets: Magnets in the capsule.
        led_spectrum: Wavelengths [nm], increasing, and relative power of its white LEDs; linear in
            between, zero outside. None is a blue LED under a yellow phosphor.
        source: Source of the parameters.
        metadata: Additional facts, stored with the device but not used.
    """

    length: float = field(metadata={"unit": "mm"})
    radius: float = field(metadata={"unit": "mm"})
    mass: float = field(metadata={"unit": "g"})
    cameras: tuple[Camera, ...]
    name: str = "custom"
    title: str = ""
    frame_rate: float = field(default=2.0, metadata={"unit": "hz"})
    lowest_frame_rate: float | None = field(default=None, metadata={"unit": "hz"})
    auto_exposure: bool = True
    image_chain: ImageChain | None = None
    magnets: tuple[InternalMagnet, ...] = ()
    led_spectrum: Spectrum | None = None
    source: str = ""
    metadata: dict = field(default_factory=dict)

    def __post_init__(self) -> None:
        plain_fields(self)
        for name, unit in (("length", "m"), ("radius", "m"), ("mass", "kg"), ("frame_rate", "1/s")):
            value = getattr(self, name)
            require(0.0 < value < np.inf, f"{name} of the capsule", value, f"above 0 {unit}")
        rate, allowed = self.frame_rate, f"above 0 to {MAX_FRAME_RATE:g} 1/s"
        require(rate <= MAX_FRAME_RATE, "frame_rate of the capsule", rate, allowed)
        if (lowest := self.lowest_frame_rate) is not None:
            allowed = f"above 0 to frame_rate, {self.frame_rate:g} 1/s"
            is_valid = 0.0 < lowest <= self.frame_rate
            require(is_valid, "lowest_frame_rate of the capsule", lowest, allowed)
        straight = 0.5 * self.length - self.radius
        if straight < 0.0:
            raise InputError(
                f"length of the capsule, {self.length:g} m, is below twice its radius, "
                f"{self.radius:g} m. Allowed: a body with round ends."
            )
        require(len(self.cameras) > 0, "number of cameras", 0, "1 or more")
        check_names(self.cameras)
        _check_positions(self, straight)
        if self.led_spectrum is not None:
            check_spectrum(self.led_spectrum)

    def camera(self, name: str) -> Camera:
        """Return a camera by its name.

        Raises:
            UnknownNameError: If the capsule has no such camera.
        """
        return camera_named(self.cameras, name)


def _check_positions(device: Device, straight: float) -> None:
    positions = {f"camera {c.name!r}": c.position for c in device.cameras}
    positions |= {f"magnet {k}": m.position_capsule for k, m in enumerate(device.magnets)}
    for name, (x, y, z) in positions.items():
        if np.hypot(np.hypot(x, y), max(abs(z) - straight, 0.0)) > device.radius:
            raise InputError(
                f"{name} is outside the body. Allowed: a position inside it, relative to the "
                "center of mass."
            )


@dataclass(frozen=True)
class Body:
    """Mass properties and shape, in the capsule frame (origin at the center of mass).

    Attributes:
        mass: Mass [kg].
        inertia: Inertia about the center of mass [kg·m²], symmetric, positive definite.
        center: Center of the cylinder [m]; its axis is along z.
        half_axis: Half the length of the straight part [m].
        radius: Radius of the cylinder and of both ends [m].
    """

    mass: float
    inertia: Float[np.ndarray, "3 3"]
    center: Float[np.ndarray, " 3"]
    half_axis: float
    radius: float

    def __post_init__(self) -> None:
        require(0.0 < self.mass < np.inf, "mass", self.mass, "above 0 kg")
        moments = np.linalg.eigvalsh(self.inertia)
        # No body has a principal moment larger than the sum of the other two.
        physical = np.isfinite(moments).all() and moments[0] > 0.0
        physical = physical and moments[2] <= (moments[0] + moments[1]) * (1.0 + 1e-9)
        require(
            bool(physical and np.allclose(self.inertia, self.inertia.T, rtol=1e-9, atol=0.0)),
            "inertia",
            np.asarray(self.inertia).tolist(),
            "symmetric, positive, and no principal moment above the sum of the other two",
        )


def homogeneous_body(device: Device) -> Body:
    """Rigid body of a device with its mass distributed evenly over its volume.

    The inertia is that of a cylinder with two half balls; their centers of mass lie 3/8 of the
    radius beyond its ends (Goldstein, Classical Mechanics, 3rd ed., 5.3, and the parallel axis
    theorem).
    """
    radius, half = device.radius, device.length / 2.0 - device.radius
    cylinder, ball = np.pi * radius**2 * 2.0 * half, 4.0 / 3.0 * np.pi * radius**3
    density = device.mass / (cylinder + ball)
    along = cylinder * radius**2 / 2.0 + ball * 0.4 * radius**2
    across = cylinder * (radius**2 / 4.0 + half**2 / 3.0)
    across += ball * (0.4 * radius**2 + half**2 + 0.75 * half * radius)
    inertia = density * np.diag([across, across, along])
    return Body(device.mass, inertia, np.zeros(3), half, radius)


Spectrum = tuple[tuple[float, float], ...]
"""Wavelengths [nm] and relative power; linear in between, zero outside."""

WAVELENGTHS = np.arange(380.0, 701.0, 4.0)
"""Sampled wavelengths [nm]."""

_CHANNELS = ((645.0, 50.0), (545.0, 90.0), (465.0, 90.0))
"""Center and full width at half maximum of red, green and blue [nm], as Gaussians: a typical sensor
after its color matrix (an assumption). In red, blood is a sixth as dense as in green, as in
`vrcaps.mucosa.mucosa.ABSORPTION`."""

_MIN_FRACTION = 0.02
"""Minimum light of a channel relative to the brightest one, for white balance."""


def _bell(middle: float, width: float) -> Float[np.ndarray, " n"]:
    """Gaussian with a full width at half maximum [nm]."""
    return np.exp(-4.0 * np.log(2.0) * ((WAVELENGTHS - middle) / width) ** 2)


PHOSPHOR: Spectrum = tuple(
    zip(WAVELENGTHS.tolist(), (_bell(450.0, 20.0) + _bell(560.0, 120.0)).tolist(), strict=True)
)
"""A blue LED at 450 nm under a yellow phosphor of equal peak power, about 5200 K by McCamy's
formula (Color Res. Appl. 17(2), 1992): the reference light, under which colors are defined."""


def channel_weights(spectrum: Spectrum) -> Float[np.ndarray, "3 n"]:
    """Fraction of each of `WAVELENGTHS` in the light of the camera's red, green and blue.

    Raises:
        InputError: If a color receives too little light for white balance.
    """
    wavelength, power = np.array(spectrum).T
    light = np.interp(WAVELENGTHS, wavelength, power, left=0.0, right=0.0)
    channels = np.array([light * _bell(*channel) for channel in _CHANNELS])
    total = channels.sum(axis=1)
    brightest = total.max() or 1.0
    for name, fraction in zip(("red", "green", "blue"), total / brightest, strict=True):
        if not fraction >= _MIN_FRACTION:
            raise InputError(
                f"LEDs of this spectrum give the camera's {name} {fraction:.1%} of the light of "
                f"its brightest color. Allowed: {_MIN_FRACTION:.0%} or more, for white balance."
            )
    return channels / total[:, None]


def check_spectrum(spectrum: Spectrum) -> None:
    """Check that a spectrum has increasing wavelengths, power, and light in every color.

    Raises:
        InputError: If one of these is missing.
    """
    wavelength, power = np.array(spectrum, float).reshape(-1, 2).T
    is_rising = len(wavelength) > 1 and bool((np.diff(wavelength) > 0.0).all())
    allowed = "two or more increasing numbers"
    require(is_rising, "wavelengths of led_spectrum", wavelength.tolist(), allowed)
    is_lit = power.min() >= 0.0 and power.max() > 0.0
    require(bool(is_lit), "power of led_spectrum", power.tolist(), "0 or above, not all 0")
    channel_weights(spectrum)
