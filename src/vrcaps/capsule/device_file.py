"""Devices by name or file: a capsule as one small TOML file that round-trips exactly.

Each key carries its unit: `_mm`, `_g`, `_hz`, `_deg`, `_px`. See `devices/mirocam.toml`. Besides
the fields of `Device` a file may contain rings of LEDs (`led_rings`), magnets by `direction` and
`preset` or the keys of a magnet file, and the spectrum of the LEDs as a table of `wavelength_nm`
and `power`.

The catalog in `devices/` holds one file per named device.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from decimal import Decimal
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np

from vrcaps.camera.camera import Camera, Led, led_ring
from vrcaps.capsule.device import Device
from vrcaps.config.convert import from_plain, register_shorthand, to_plain
from vrcaps.config.plain_files import CatalogFolder, read_plain, write_toml
from vrcaps.core.errors import InputError, require
from vrcaps.magnet.magnets import SHAPES
from vrcaps.magnet.presets import read_magnet
from vrcaps.magnet.sources import Block, Cylinder, InternalMagnet, Magnet, Ring, Sphere

_LED_RINGS = "led_rings"
_MAX_LED_DISTANCE = 0.2
"""Maximum distance of an LED from its camera [m]; beyond, a file is in another unit."""

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class LedRing:
    """LEDs on a circle around the optical axis, pointing along it, as in a device file.

    Attributes:
        center: Center of the circle in the camera frame [m].
        radius: Radius of the circle [m].
        angles: Angle of each LED, from camera x (right) to y (down) [rad].
        intensity: Radiant intensity of each on its axis for red, green, blue [W/sr].
        lobe_exponent: Exponent of their angular lobe.
        emitter_radius: Radius of the luminous disc of each LED [m]; 0 is a point light.
    """

    center: Vector = field(metadata={"unit": "mm"})
    radius: float = field(metadata={"unit": "mm"})
    angles: tuple[float, ...] = field(metadata={"unit": "deg"})
    intensity: Vector = field(metadata={"unit": "mw_per_sr"})
    lobe_exponent: float
    emitter_radius: float = field(default=0.0, metadata={"unit": "mm"})

    def __post_init__(self) -> None:
        require(len(self.angles) > 0, "angles", [], "one or more")

    @property
    def leds(self) -> tuple[Led, ...]:
        """The LEDs of the ring."""
        return led_ring(
            self.angles,
            self.radius,
            center=self.center,
            intensity=self.intensity,
            lobe_exponent=self.lobe_exponent,
            emitter_radius=self.emitter_radius,
        )


@dataclass(frozen=True)
class ShapedMagnet:
    """Magnet fixed in a capsule by its preset or shape, as in a device file.

    Attributes:
        position: Center of the magnet in the capsule frame [m].
        direction: Direction of its moment in the capsule frame, of any length.
        preset: Name of the magnet, see `vrcaps.magnet.presets`.
        magnet: The magnet itself, as in a magnet file; None if a preset is given.
    """

    position: Vector = field(metadata={"unit": "mm"})
    direction: Vector
    preset: str = ""
    magnet: Cylinder | Ring | Block | Sphere | None = None

    @property
    def internal(self) -> InternalMagnet:
        """Return the magnet with its moment.

        Raises:
            UnknownNameError: If the preset does not exist.
            InputError: If the direction is zero.
        """
        direction = np.array(self.direction)
        length = np.linalg.norm(direction)
        if length == 0.0:
            raise InputError("direction is zero. Allowed: any direction but zero.")
        moment = read_magnet(self.preset if self.magnet is None else self.magnet).moment
        x, y, z = (moment * direction / length).tolist()
        return InternalMagnet(self.position, (x, y, z))


@dataclass(frozen=True)
class _Spectrum:
    """Spectrum of the LEDs as in a device file.

    Attributes:
        wavelength: Wavelengths [nm].
        power: Relative power at each wavelength.
    """

    wavelength: tuple[float, ...] = field(metadata={"unit": "nm"})
    power: tuple[float, ...]


def read_device_file(path: Path) -> Device:
    """Read a device from its TOML file; the device is named after the file.

    Raises:
        InputError: If the file cannot be read, is not TOML, lacks a key, has an unknown key or one
            of the wrong type, contains an impossible lens, pose or size, or an LED more than 0.2 m
            from its camera.
    """
    plain = read_plain(path, "device")
    device = from_plain(Device, {"name": path.stem, **plain}, at=f"{path.name}:", units=True)
    for camera in device.cameras:
        away = max((float(np.linalg.norm(led.position_camera)) for led in camera.leds), default=0.0)
        allowed = f"up to {_MAX_LED_DISTANCE:g} m"
        require(away <= _MAX_LED_DISTANCE, f"{path.name}: distance of an LED", away, allowed)
    return device


def write_device(path: Path, device: Device) -> None:
    """Write a device as TOML; `read_device_file` reads an equal device, named after the file.

    Raises:
        InputError: If the file cannot be written.
    """
    plain = to_plain(device, Device, units=True)
    del plain["name"]
    stated = {key: value for key, value in plain.items() if value not in ("", [], {})}
    write_toml(path, stated, "device")


def _expand_camera(plain: dict[str, Any]) -> dict[str, Any]:
    rings = plain.pop(_LED_RINGS, None)
    for key in get_close_matches(_LED_RINGS, plain, 1, cutoff=0.8):
        raise InputError(f"Unknown key {key}. Did you mean {_LED_RINGS}?")
    if rings is None:
        return plain
    expanded = from_plain(tuple[LedRing, ...], rings, at=_LED_RINGS, units=True)
    return {
        **plain,
        "leds": [*plain.get("leds", []), *(led for ring in expanded for led in ring.leds)],
    }


def _expand_magnet(plain: dict[str, Any]) -> dict[str, Any]:
    if "preset" not in plain and "kind" not in plain:
        for key in sorted(set(plain) - {"position_mm", "moment_a_m2"}):
            raise InputError(
                f"Unknown key {key}. Allowed: position_mm with moment_a_m2; or with direction and "
                "preset; or with direction and the keys of a magnet file: kind "
                f"({', '.join(shape.kind for shape in SHAPES)}), size, and grade, remanence_t or "
                "moment_a_m2."
            )
        return plain
    own = {key: plain[key] for key in ("position_mm", "direction", "preset") if key in plain}
    if "kind" in plain:
        own["magnet"] = {key: value for key, value in plain.items() if key not in own}
        plain = own
    shaped = from_plain(ShapedMagnet, own | plain, at="magnet", units=True)
    moment = list(shaped.internal.moment_capsule)
    return {"position_mm": plain["position_mm"], "moment_a_m2": moment}


def _require_fit(plain: dict[str, Any]) -> None:
    """Check that the magnets given by shape are not larger or heavier than the capsule."""
    magnets = [m for m in plain.get("magnets", []) if isinstance(m, dict) and "kind" in m]
    if not (magnets and all(_is_number(plain.get(k)) for k in ("mass_g", "radius_mm"))):
        return  # another check reports it
    for index, magnet in enumerate(magnets):
        shape = {k: v for k, v in magnet.items() if k not in ("position_mm", "direction")}
        made = from_plain(Magnet, shape, at=f"magnets[{index}]", units=True)
        mass, width = 1e3 * made.mass, 1e3 * min(made.bounds)
        if mass > plain["mass_g"] or width > 2 * plain["radius_mm"]:
            raise InputError(
                f"magnets[{index}] weighs {mass:.3g} g and is {width:.3g} mm wide. Allowed: up to "
                f"the capsule's {float(plain['mass_g']):g} g and {2 * float(plain['radius_mm']):g} "
                "mm."
            )


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float | Decimal) and not isinstance(value, bool)


def _expand_device(plain: dict[str, Any]) -> dict[str, Any]:
    _require_fit(plain)
    if not isinstance(plain.get("led_spectrum"), dict):
        return plain
    spectrum = from_plain(_Spectrum, plain["led_spectrum"], at="led_spectrum", units=True)
    if len(spectrum.power) != len(spectrum.wavelength):
        raise InputError(
            f"led_spectrum.power has {len(spectrum.power)} values. Allowed: as many as "
            f"wavelength_nm, {len(spectrum.wavelength)}."
        )
    return {**plain, "led_spectrum": list(zip(spectrum.wavelength, spectrum.power, strict=True))}


register_shorthand(Camera, _expand_camera)
register_shorthand(InternalMagnet, _expand_magnet)
register_shorthand(Device, _expand_device)


_DEVICES = CatalogFolder(Path(__file__).parent / "devices", "capsule")
_parsed: dict[str, Device] = {}  # devices of the catalog that this process has read


def device_names() -> tuple[str, ...]:
    """Names of the catalog's devices, sorted."""
    return _DEVICES.names()


def read_device(name_or_path: str | Path) -> Device:
    """Read a device of the catalog by its name, or a custom device by the path of its TOML file.

    A file of the catalog is parsed once per process, a custom file each time.

    Raises:
        UnknownNameError: If the catalog has no device of that name.
        InputError: If the file does not exist, or describes an impossible device.
    """
    if (known := _parsed.get(str(name_or_path))) is not None:
        return known
    path = _DEVICES.find(name_or_path)
    device = read_device_file(path)
    if path.parent == _DEVICES.path:
        _parsed[path.stem] = device
    return device


def device_of(given: str | Device) -> Device:
    """Return a device in memory unchanged, or read it by name or file.

    Raises:
        InputError: If a file contains no device.
        UnknownNameError: If no device has the name.
    """
    return given if isinstance(given, Device) else read_device(given)
