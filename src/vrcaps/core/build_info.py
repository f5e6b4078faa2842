"""Versions that determine output bytes besides the input: the compiled core and the packages."""

from __future__ import annotations

import hashlib
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from vrcaps import _core

ORGAN_PACKAGES = ("numpy", "potpourri3d", "scikit-image", "scipy", "xatlas")
"""Packages that compute an organ."""

EPISODE_PACKAGES = (*ORGAN_PACKAGES, "av", "pillow", "pyarrow", "pyoidn")
"""Packages that compute or write a file of an episode."""


@cache
def core_sha256() -> str:
    """SHA-256 checksum of the compiled core, in hexadecimal."""
    return hashlib.sha256(Path(_core.__file__).read_bytes()).hexdigest()


def versions(packages: tuple[str, ...]) -> dict[str, str]:
    """Versions of packages, empty for those that are not installed."""
    return {name: _version(name) for name in packages}


def made_here() -> dict[str, str]:
    """Versions of vrcaps, its core and all packages that an episode's bytes depend on."""
    own = {"vrcaps": _core.__version__, "core_sha256": core_sha256()}
    return {**own, **versions(EPISODE_PACKAGES)}


@cache
def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return ""
