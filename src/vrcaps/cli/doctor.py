"""`vrcaps doctor`: report on the installation and the machine."""

from __future__ import annotations

import os
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, requires, version

from vrcaps.cli.console import console


@dataclass(frozen=True)
class Doctor:
    """Print the version, the CPU features and threads in use, the catalog, and the extras.

    For an extra that is not installed, the command to install it is printed.

    For example:
      vrcaps doctor
    """

    def run(self) -> None:
        """Print the report."""
        from rich.table import Table

        table = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
        for row in [*_machine(), *_extras()]:
            table.add_row(*row)
        console.print(table)


def _machine() -> list[tuple[str, str]]:
    import platform

    from vrcaps import _core
    from vrcaps.anatomy.catalog import ORGANS
    from vrcaps.capsule.device_file import device_names

    return [
        ("vrcaps", version("vrcaps")),
        ("Python", f"{platform.python_version()} on {platform.system()} {platform.machine()}"),
        ("CPU features in use", ", ".join(_core.cpu_features()) or "baseline"),
        ("threads", f"{_core.num_threads()} of {os.cpu_count()} (RAYON_NUM_THREADS changes it)"),
        ("organs", ", ".join(sorted(ORGANS))),
        ("capsules", ", ".join(device_names())),
    ]


def _extras() -> list[tuple[str, str]]:
    """One row per extra: the versions of its packages, or how to install the missing ones."""
    from packaging.requirements import Requirement

    packages: dict[str, list[str]] = {}
    for line in requires("vrcaps") or []:
        requirement = Requirement(line)
        marker = str(requirement.marker or "")
        if "extra ==" in marker and requirement.marker is not None:
            extra = marker.rsplit("extra ==", 1)[1].strip(" \"')")
            if requirement.marker.evaluate({"extra": extra}):
                packages.setdefault(extra, []).append(requirement.name)
    return [(f"[{extra}]", _installed(extra, names)) for extra, names in sorted(packages.items())]


def _installed(extra: str, names: list[str]) -> str:
    found, missing = [], []
    for name in names:
        try:
            found.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            missing.append(name)
    if missing:
        return f"missing {', '.join(missing)}: pip install 'vrcaps[{extra}]'"
    return ", ".join(found)
