"""`vrcaps doctor`: report on the installation and the machine."""

from __future__ import annotations

import os
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, requires, version

from vrcaps.cli.console import console
from vrcaps.core.errors import VrcapsError

_OF_DEVELOPERS = ("dev", "docs")
"""Extras that users do not need."""
_MIN_FREE_GB = 5.0
"""Free disk space below which the cache may fill the disk [GB]."""


@dataclass(frozen=True)
class Doctor:
    """Report the installed and usable parts, and how to install missing ones.

    Lists version, CPU features and threads, catalogs, the folders of cache and weights, and
    packages of each extra.

    For example:
      vrcaps doctor
    """

    def run(self) -> None:
        """Print the report."""
        from rich.table import Table

        table = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
        rows = [*_machine(), ("cache", _cache()), ("weights", _weights()), *_extras()]
        for row in rows:
            table.add_row(*row)
        console.print(table)


def _machine() -> list[tuple[str, str]]:
    import platform

    from vrcaps import _core
    from vrcaps.capsule.device_file import device_names
    from vrcaps.organ.segments import ORGANS

    return [
        ("vrcaps", version("vrcaps")),
        ("Python", f"{platform.python_version()} on {platform.system()} {platform.machine()}"),
        ("CPU features in use", ", ".join(_core.cpu_features()) or "baseline"),
        ("threads", f"{_core.num_threads()} of {os.cpu_count()} (RAYON_NUM_THREADS changes it)"),
        ("organs", ", ".join(sorted(ORGANS))),
        ("capsules", ", ".join(device_names())),
    ]


def _cache() -> str:
    """State of the cache folder."""
    import shutil

    from vrcaps.core.files import cache_folder

    folder = cache_folder()
    existing = next((path for path in (folder, *folder.parents) if path.exists()), folder)
    if not os.access(existing, os.W_OK):
        return f"{folder} cannot be written: set VRCAPS_CACHE to another folder"
    free = shutil.disk_usage(existing).free / 1e9
    advice = "" if free > _MIN_FREE_GB else ": free space, or set VRCAPS_CACHE to another disk"
    return f"{folder}, {free:.0f} GB free{advice}"


def _weights() -> str:
    """Published weights that commands find by name."""
    from vrcaps.learn.hub import read_index, weights_folder

    try:
        folder = weights_folder()
        return f"{', '.join(read_index(folder))} in {folder}"
    except VrcapsError as error:
        return f"none: {error}"


def _extras() -> list[tuple[str, str]]:
    """One row per extra: the versions of its packages, or how to install the missing ones."""
    from packaging.requirements import Requirement

    packages: dict[str, list[str]] = {}
    for line in requires("vrcaps") or []:
        requirement = Requirement(line)
        marker = str(requirement.marker or "")
        if "extra ==" in marker and requirement.marker is not None:
            extra = marker.rsplit("extra ==", 1)[1].strip(" \"')")
            if extra not in _OF_DEVELOPERS and requirement.marker.evaluate({"extra": extra}):
                packages.setdefault(extra, []).append(requirement.name)
    return [(f"[{extra}]", _installed(extra, names)) for extra, names in sorted(packages.items())]


def _installed(extra: str, names: list[str]) -> str:
    installed, missing = [], []
    for name in names:
        try:
            installed.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            missing.append(name)
    if missing:
        return f"missing {', '.join(missing)}: pip install 'vrcaps[{extra}]'"
    return ", ".join(installed)
