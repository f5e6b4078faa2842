"""Catalog of named devices: one TOML file each in `devices/`, and custom device files."""

from __future__ import annotations

from pathlib import Path

from vrcaps.capsule.device import Device
from vrcaps.capsule.device_file import read_device_file
from vrcaps.config.catalog import CatalogFolder

_DEVICES = CatalogFolder(Path(__file__).parent / "devices", "capsule")


def device_names() -> tuple[str, ...]:
    """Names of the catalog's devices, sorted."""
    return _DEVICES.names()


def read_device(name_or_path: str | Path) -> Device:
    """Read a device of the catalog by its name, or a custom device by the path of its TOML file.

    Raises:
        UnknownNameError: If the catalog has no device of that name.
        InputError: If the file does not exist, or describes an impossible device.
    """
    return read_device_file(_DEVICES.find(name_or_path))


def device_of(given: str | Device) -> Device:
    """Return a device in memory unchanged, or read it by name or file.

    Raises:
        InputError: If a file contains no device.
        UnknownNameError: If no device has the name.
    """
    return given if isinstance(given, Device) else read_device(given)
