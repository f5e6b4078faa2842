"""`vrcaps doctor` states how to fix each missing piece."""

from __future__ import annotations

import shutil
from importlib.metadata import PackageNotFoundError
from pathlib import Path
from types import SimpleNamespace

import pytest

import vrcaps
from vrcaps.cli import doctor, main


@pytest.fixture
def report(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):
    """Text of the report on one line."""
    monkeypatch.setattr(doctor.console, "_width", 400)

    def run() -> str:
        main(["doctor"])
        return " ".join(capsys.readouterr().out.split())

    return run


def test_versions_and_catalogs(report):
    text = report()
    assert f"vrcaps {vrcaps.__version__}" in text
    assert "organs colon, full-tract, small-bowel, stomach" in text
    assert "[dev]" not in text


def test_a_missing_package_names_its_extra(report, monkeypatch: pytest.MonkeyPatch):
    known = doctor.version

    def version(name: str) -> str:
        if name == "viser":
            raise PackageNotFoundError(name)
        return known(name)

    monkeypatch.setattr(doctor, "version", version)
    assert "[cockpit] missing viser: pip install 'vrcaps[cockpit]'" in report()


def test_missing_weights_name_the_command_that_fetches_them(
    report, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    monkeypatch.setenv("VRCAPS_WEIGHTS", str(tmp_path))
    text = report()
    assert f"weights none: {tmp_path}" in text and "contains no index.json" in text
    monkeypatch.delenv("VRCAPS_WEIGHTS")
    monkeypatch.setattr("vrcaps.learn.hub._CHECKOUT", tmp_path)
    monkeypatch.setattr("vrcaps.learn.hub.download_folder", lambda: tmp_path)
    assert "weights none: There are no published weights" in report()


def test_a_full_disk_and_a_folder_without_permission(
    report, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    monkeypatch.setenv("VRCAPS_CACHE", str(tmp_path / "new" / "cache"))
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=1.2e9))
    assert "1 GB free: free space, or set VRCAPS_CACHE to another disk" in report()
    monkeypatch.setattr("os.access", lambda path, mode: False)
    assert "cannot be written: set VRCAPS_CACHE to another folder" in report()
