"""Plug-in installed in a folder on the path."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from vrcaps.core.registry import load_plugins


def install(folder: Path, code: str) -> None:
    """Write a distribution with one plug-in."""
    (folder / "the_plugin.py").write_text(code)
    about = folder / "the_plugin-1.2.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: the-plugin\nVersion: 1.2\n")
    (about / "entry_points.txt").write_text("[vrcaps.plugins]\nmine = the_plugin\n")


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Folder of installed distributions, without plug-ins at first."""
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "the_plugin", raising=False)
    load_plugins.cache_clear()
    yield tmp_path
    load_plugins.cache_clear()
