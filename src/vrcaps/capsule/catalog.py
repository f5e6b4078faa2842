"""The catalog of named devices: one TOML file each in `devices/`, and a user's own files."""

from __future__ import annotations

from pathlib import Path

from vrcaps.capsule.device import Device
from vrcaps.capsule.device_file import read_device
from vrcaps.errors import InputError, UnknownNameError

_DEVICES = Path(__file__).parent / "devices"


def device_names() -> tuple[str, ...]:
    """Names of the catalog's devices, sorted."""
    return tuple(sorted(path.stem for path in _DEVICES.glob("*.toml")))


def load_device(name_or_path: str | Path) -> Device:
    """A device of the catalog by its name, or a user's own by the path of its TOML file.

    Raises:
        UnknownNameError: If the catalog has no device of that name.
        InputError: If there is no such file, or it describes no possible device.
    """
    path = Path(name_or_path)
    if path.suffix == ".toml" or len(path.parts) > 1:
        if not path.is_file():
            known = ", ".join(device_names())
            raise InputError(f"No device file at {path}. Give a TOML file, or one of: {known}.")
        return read_device(path)
    if str(name_or_path) not in device_names():
        raise UnknownNameError("capsule", str(name_or_path), device_names())
    return read_device(_DEVICES / f"{name_or_path}.toml")
