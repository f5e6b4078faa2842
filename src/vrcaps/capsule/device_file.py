"""A device as one small TOML file: read strictly, written so that it reads back equal.

Each key carries its unit: `_mm`, `_g`, `_hz`, `_deg`, `_px`. See `devices/mirocam.toml`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import MISSING, fields
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np

from vrcaps.camera.camera import Camera, Led, led_ring
from vrcaps.camera.lens import LENSES, Lens
from vrcaps.camera.rays import camera_rays
from vrcaps.capsule.device import Device
from vrcaps.errors import InputError
from vrcaps.files import write_bytes
from vrcaps.magnet.internal import InternalMagnet
from vrcaps.magnet.presets import MAGNETS, magnet_names, read_magnet
from vrcaps.toml_table import (
    DEGREE,
    MILLI,
    ONE,
    TomlTable,
    decimal_text,
    plain,
    toml_text,
)
from vrcaps.transforms import transform_from

_LENS_KEYS = {
    **{name: (f"{name}_px", ONE) for name in ("fx", "fy", "cx", "cy", "focal", "skew", "a0")},
    "max_angle": ("max_angle_deg", DEGREE),
}
"""Key and unit of the lens fields that have one; the other fields are coefficients."""
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]*")
_ORTHONORMAL = 1e-6
_WIDEST = 16384


def read_device_file(path: Path) -> Device:
    """Read a device from its TOML file; its name is the file's name.

    Raises:
        InputError: If the file cannot be read, is no TOML, lacks a key, has a key too many or of
            the wrong type, or holds a lens, pose or size that cannot be.
    """
    table = TomlTable.read(path, "device")
    title, source = table.text("title"), table.text("source") if table.has("source") else ""
    metadata = plain(table.table("metadata").entries) if table.has("metadata") else {}
    length = table.number("length_mm", MILLI, above=0)
    radius = table.number("radius_mm", MILLI, above=0)
    mass = table.number("mass_g", MILLI, above=0)
    frame_rate = table.number("frame_rate_hz", above=0)
    cameras = tuple(_read_camera(camera) for camera in table.tables("cameras"))
    magnets = tuple(map(_read_magnet, table.tables("magnets"))) if table.has("magnets") else ()
    has_spectrum = table.has("led_spectrum")
    spectrum = _read_spectrum(table.table("led_spectrum")) if has_spectrum else None
    table.finish()
    device = Device(
        name=path.stem,
        title=title,
        length=length,
        radius=radius,
        mass=mass,
        frame_rate=frame_rate,
        cameras=cameras,
        magnets=magnets,
        led_spectrum=spectrum,
        source=source,
        metadata=metadata,
    )
    _check_body(device, table.where)
    return device


def write_device(path: Path, device: Device) -> None:
    """Write a device as TOML; `read_device_file` gives it back equal, under the file's name.

    Raises:
        InputError: If the file cannot be written.
    """
    lines = [
        f"title = {toml_text(device.title)}",
        f"source = {toml_text(device.source)}",
        f"length_mm = {decimal_text(device.length, MILLI)}",
        f"radius_mm = {decimal_text(device.radius, MILLI)}",
        f"mass_g = {decimal_text(device.mass, MILLI)}",
        f"frame_rate_hz = {decimal_text(device.frame_rate)}",
    ]
    if device.led_spectrum is not None:
        wavelength, power = zip(*device.led_spectrum, strict=True)
        lines += ["", "[led_spectrum]", f"wavelength_nm = [{_joined(wavelength)}]"]
        lines += [f"power = [{_joined(power)}]"]
    if device.metadata:
        lines += ["", "[metadata]"]
        lines += [f"{toml_text(k)} = {toml_text(v)}" for k, v in device.metadata.items()]
    for camera in device.cameras:
        lines += ["", "[[cameras]]", *_camera_lines(camera)]
    for magnet in device.magnets:
        lines += [
            "",
            "[[magnets]]",
            f"position_mm = [{_joined(magnet.position_capsule, MILLI)}]",
            f"moment_a_m2 = [{_joined(magnet.moment_capsule)}]",
        ]
    write_lines(path, lines)


def write_lines(path: Path, lines: Iterable[str]) -> None:
    """Write a text file whole or not at all.

    Raises:
        InputError: If the file cannot be written.
    """
    try:
        write_bytes(path, ("\n".join(lines) + "\n").encode())
    except OSError as error:
        raise InputError(f"Cannot write the device file {path}: {error.strerror}.") from error


def _read_spectrum(table: TomlTable) -> tuple[tuple[float, float], ...]:
    wavelength = table.numbers("wavelength_nm")
    if len(wavelength) < 2 or not (np.diff(wavelength) > 0.0).all():
        allowed = "two or more numbers that rise"
        table.fail("wavelength_nm", table.entries["wavelength_nm"], allowed)
    power = table.numbers("power", len(wavelength))
    if min(power) < 0.0 or max(power) == 0.0:
        table.fail("power", table.entries["power"], "0 or above, not all 0")
    table.finish()
    return tuple(zip(wavelength, power, strict=True))


def _read_magnet(table: TomlTable) -> InternalMagnet:
    """A magnet by its moment, or by its name in `vrcaps.magnet.presets` and its direction."""
    x, y, z = table.numbers("position_mm", 3, MILLI)
    if table.has("preset"):
        name, direction = table.text("preset"), np.array(table.numbers("direction", 3))
        if name not in MAGNETS:
            table.fail("preset", name, ", ".join(magnet_names()))
        length = np.linalg.norm(direction)
        if length == 0.0:
            table.fail("direction", table.entries["direction"], "any direction but zero")
        moment = tuple((read_magnet(name).moment * direction / length).tolist())
    else:
        moment = table.numbers("moment_a_m2", 3)
        if not any(moment):
            table.fail("moment_a_m2", table.entries["moment_a_m2"], "any moment but zero")
    table.finish()
    return InternalMagnet((x, y, z), (moment[0], moment[1], moment[2]))


def _read_camera(table: TomlTable) -> Camera:
    name = table.text("name")
    if not _NAME.fullmatch(name):
        table.fail("name", name, "letters, digits, - and _ (it names a folder)")
    size = table.integer("width_px", _WIDEST), table.integer("height_px", _WIDEST)
    position = np.array(table.numbers("position_mm", 3, MILLI))
    pose = transform_from(_read_rotation(table), position)
    lens = _read_lens(table.table("lens"))
    exposure = table.number("exposure_m2_sr_per_w", above=0)
    circle = table.number("image_circle_px", above=0) if table.has("image_circle_px") else None
    nominal = "nominal_field_deg"
    field = table.number(nominal, DEGREE, above=0) if table.has(nominal) else None
    leds: list[Led] = []
    if table.has("leds"):
        leds += [_read_led(led) for led in table.tables("leds")]
    if table.has("led_rings"):
        leds += [led for ring in table.tables("led_rings") for led in _read_ring(ring)]
    table.finish()
    camera = Camera(name, lens, *size, pose, tuple(leds), exposure, circle, field)
    _check_image(camera, table.where)
    return camera


def _read_rotation(table: TomlTable) -> np.ndarray:
    """Rotation ``R_capsule_camera``: its columns are the camera's x, y, z in the capsule frame."""
    allowed = "three rows of three numbers, orthonormal and right-handed (R_capsule_camera)"
    rows = table.take("rotation", allowed)
    if not (isinstance(rows, list) and len(rows) == 3):
        table.fail("rotation", rows, allowed)
    rotation = np.array(
        [TomlTable({"rotation": row}, table.where).numbers("rotation", 3) for row in rows]
    )
    error = np.abs(rotation @ rotation.T - np.eye(3)).max()
    if error > _ORTHONORMAL or np.linalg.det(rotation) < 0.0:
        table.fail("rotation", rows, allowed)
    return rotation


def _read_lens(table: TomlTable) -> Lens:
    kind = table.text("kind")
    if kind not in LENSES:
        table.fail("kind", kind, ", ".join(sorted(LENSES)))
    values: dict[str, float] = {}
    for parameter in fields(LENSES[kind]):  # type: ignore[arg-type]
        key, unit = _LENS_KEYS.get(parameter.name, (parameter.name, ONE))
        if parameter.default is MISSING or table.has(key):
            values[parameter.name] = table.number(key, unit)
    table.finish()
    try:
        return LENSES[kind](**values)
    except InputError as error:
        raise InputError(f"{table.where}: {error}") from error


def _read_light(table: TomlTable) -> dict[str, Any]:
    lobe = table.number("lobe_exponent")
    if lobe < 0.0:
        table.fail("lobe_exponent", table.entries["lobe_exponent"], "0 or above")
    intensity = table.numbers("intensity_mw_per_sr", 3, MILLI)
    if min(intensity) < 0.0:
        table.fail("intensity_mw_per_sr", table.entries["intensity_mw_per_sr"], "0 or above")
    return {"intensity": intensity, "lobe_exponent": lobe}


def _read_led(table: TomlTable) -> Led:
    position = table.numbers("position_mm", 3, MILLI)
    direction = np.array(table.numbers("direction", 3))
    length = np.linalg.norm(direction)
    if length == 0.0:
        table.fail("direction", table.entries["direction"], "any direction but zero")
    if abs(length - 1.0) > 1e-12:
        direction = direction / length
    light = _read_light(table)
    table.finish()
    return Led(position, tuple(direction.tolist()), **light)  # type: ignore[arg-type]


def _read_ring(table: TomlTable) -> list[Led]:
    """LEDs on a circle across the optical axis; angles run from camera x (right) to y (down)."""
    centre = np.array(table.numbers("centre_mm", 3, MILLI))
    radius = table.number("radius_mm", MILLI, above=0)
    angles = np.array(table.numbers("angles_deg", None, DEGREE))
    light = _read_light(table)
    table.finish()
    return list(led_ring(angles.tolist(), radius, center=tuple(centre.tolist()), **light))


def _check_image(camera: Camera, where: str) -> None:
    lens = camera.lens
    for axis, centre, size in (("cx", lens.cx, camera.width), ("cy", lens.cy, camera.height)):
        if not -0.5 <= centre <= size - 0.5:
            raise InputError(
                f"{where}: lens centre {axis} = {centre:g} px is outside the image. "
                f"Allowed: -0.5 to {size - 0.5:g}."
            )
    if not np.isfinite(camera_rays(camera)).any():
        raise InputError(
            f"{where}: no pixel of the image is in the lens's field. "
            "Check its focal length, max_angle_deg and image_circle_px."
        )


def _check_body(device: Device, where: str) -> None:
    straight = 0.5 * device.length - device.radius
    if straight < 0.0:
        raise InputError(
            f"{where}: length_mm is below twice radius_mm. Allowed: a body with round ends."
        )
    names = [camera.name for camera in device.cameras]
    if len(set(names)) < len(names):
        raise InputError(f"{where}: two cameras share a name ({', '.join(names)}).")
    places = {f"camera {c.name!r}": c.T_capsule_camera[:3, 3] for c in device.cameras}
    places |= {f"magnet {k}": m.position_capsule for k, m in enumerate(device.magnets)}
    for what, (x, y, z) in places.items():
        if np.hypot(np.hypot(x, y), max(abs(z) - straight, 0.0)) > device.radius:
            raise InputError(
                f"{where}: {what} is outside the body. "
                "Allowed: position_mm inside it, from the centre of mass."
            )


def _camera_lines(camera: Camera) -> list[str]:
    rows = (f"[{_joined(row)}]" for row in camera.T_capsule_camera[:3, :3])
    lines = [
        f"name = {toml_text(camera.name)}",
        f"width_px = {camera.width}",
        f"height_px = {camera.height}",
        f"position_mm = [{_joined(camera.T_capsule_camera[:3, 3], MILLI)}]",
        f"rotation = [{', '.join(rows)}]",
        f"exposure_m2_sr_per_w = {decimal_text(camera.exposure)}",
    ]
    if camera.image_circle_px is not None:
        lines.append(f"image_circle_px = {decimal_text(camera.image_circle_px)}")
    if camera.nominal_field is not None:
        lines.append(f"nominal_field_deg = {decimal_text(camera.nominal_field, DEGREE)}")
    lines += ["", "[cameras.lens]", *_lens_lines(camera.lens)]
    for led in camera.leds:
        lines += [
            "",
            "[[cameras.leds]]",
            f"position_mm = [{_joined(led.position_camera, MILLI)}]",
            f"direction = [{_joined(led.direction_camera)}]",
            f"intensity_mw_per_sr = [{_joined(led.intensity, MILLI)}]",
            f"lobe_exponent = {decimal_text(led.lobe_exponent)}",
        ]
    return lines


def _lens_lines(lens: Lens) -> list[str]:
    lines = [f"kind = {toml_text(lens.kind)}"]
    for parameter in fields(lens):  # type: ignore[arg-type]
        key, unit = _LENS_KEYS.get(parameter.name, (parameter.name, ONE))
        value = getattr(lens, parameter.name)
        if value is not None:
            lines.append(f"{key} = {decimal_text(value, unit)}")
    return lines


def _joined(values: Any, unit: Decimal = ONE) -> str:
    return ", ".join(decimal_text(float(value), unit) for value in values)
