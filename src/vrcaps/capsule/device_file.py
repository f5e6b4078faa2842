"""A device as one small TOML file: read strictly, written so that it reads back equal.

Each key carries its unit: `_mm`, `_g`, `_hz`, `_deg`, `_px`. See `devices/mirocam.toml`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import MISSING, Field, fields
from decimal import Decimal
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from vrcaps.camera.camera import Camera, Led, led_ring
from vrcaps.camera.lens import LENSES, Lens
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

_WIDEST = 16384
_Made = TypeVar("_Made")


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
    return _made(
        table,
        Device,
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
    power = table.numbers("power", len(wavelength))
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
    values: dict[str, Any] = {
        "name": table.text("name"),
        "width": table.integer("width_px", _WIDEST),
        "height": table.integer("height_px", _WIDEST),
        "position": table.numbers("position_mm", 3, MILLI),
        "rotation": _read_rotation(table),
        "lens": _read_lens(table.table("lens")),
        "exposure": table.number("exposure_m2_sr_per_w", above=0),
    }
    if table.has("image_circle_px"):
        values["image_circle_px"] = table.number("image_circle_px", above=0)
    if table.has("nominal_field_deg"):
        values["nominal_field"] = table.number("nominal_field_deg", DEGREE, above=0)
    leds: list[Led] = []
    if table.has("leds"):
        leds += [_read_led(led) for led in table.tables("leds")]
    if table.has("led_rings"):
        leds += [led for ring in table.tables("led_rings") for led in _read_ring(ring)]
    table.finish()
    return _made(table, Camera, leds=tuple(leds), **values)


def _made(table: TomlTable, make: Callable[..., _Made], **values: Any) -> _Made:
    """What a table describes, with the table's place in what is wrong."""
    try:
        return make(**values)
    except InputError as error:
        raise InputError(f"{table.where}: {error}") from error


def _read_rotation(table: TomlTable) -> tuple[tuple[float, ...], ...]:
    """Rotation ``R_capsule_camera``: its columns are the camera's x, y, z in the capsule frame."""
    allowed = "three rows of three numbers, orthonormal and right-handed (R_capsule_camera)"
    rows = table.take("rotation", allowed)
    if not (isinstance(rows, list) and len(rows) == 3):
        table.fail("rotation", rows, allowed)
    return tuple(
        tuple(TomlTable({"rotation": row}, table.where).numbers("rotation", 3)) for row in rows
    )


def _read_lens(table: TomlTable) -> Lens:
    kind = table.text("kind")
    if kind not in LENSES:
        table.fail("kind", kind, ", ".join(sorted(LENSES)))
    values: dict[str, float] = {}
    for parameter in fields(LENSES[kind]):  # type: ignore[arg-type]
        key, unit = _key_and_unit(parameter)
        if parameter.default is MISSING or table.has(key):
            values[parameter.name] = table.number(key, unit)
    table.finish()
    return _made(table, LENSES[kind], **values)


def _read_light(table: TomlTable) -> dict[str, Any]:
    intensity = table.numbers("intensity_mw_per_sr", 3, MILLI)
    return {"intensity": intensity, "lobe_exponent": table.number("lobe_exponent")}


def _read_led(table: TomlTable) -> Led:
    position = table.numbers("position_mm", 3, MILLI)
    direction = table.numbers("direction", 3)
    light = _read_light(table)
    table.finish()
    return _made(table, Led, position_camera=position, direction_camera=direction, **light)


def _read_ring(table: TomlTable) -> tuple[Led, ...]:
    center = table.numbers("center_mm", 3, MILLI)
    radius = table.number("radius_mm", MILLI, above=0)
    angles = table.numbers("angles_deg", None, DEGREE)
    light = _read_light(table)
    table.finish()
    return _made(table, led_ring, angles=angles, center=center, radius=radius, **light)


def _camera_lines(camera: Camera) -> list[str]:
    rows = (f"[{_joined(row)}]" for row in camera.rotation)
    lines = [
        f"name = {toml_text(camera.name)}",
        f"width_px = {camera.width}",
        f"height_px = {camera.height}",
        f"position_mm = [{_joined(camera.position, MILLI)}]",
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
        key, unit = _key_and_unit(parameter)
        value = getattr(lens, parameter.name)
        if value is not None:
            lines.append(f"{key} = {decimal_text(value, unit)}")
    return lines


def _key_and_unit(parameter: Field) -> tuple[str, Decimal]:
    """Key and unit of a lens's parameter, by its metadata."""
    unit = parameter.metadata.get("unit")
    key = parameter.name if unit is None else f"{parameter.name}_{unit}"
    return key, DEGREE if unit == "deg" else ONE


def _joined(values: Any, unit: Decimal = ONE) -> str:
    return ", ".join(decimal_text(float(value), unit) for value in values)
