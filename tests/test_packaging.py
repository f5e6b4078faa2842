"""The installed package: its version, its extras, and a wheel that runs without a compiler."""

from __future__ import annotations

import json
import os
import re
import subprocess
import tomllib
import venv
from importlib.metadata import version
from pathlib import Path

import pytest
import yaml

import vrcaps
from tests.support.waiting import WATCHDOG

ROOT = Path(__file__).resolve().parents[1]


def test_one_version_everywhere() -> None:
    crate = tomllib.loads((ROOT / "rust" / "Cargo.toml").read_text())["package"]["version"]
    assert crate == version("vrcaps") == vrcaps.__version__


HEAVY = {
    "SimpleITK": "ct",
    "av": "video",
    "gymnasium": "env",
    "matplotlib": "reports",
    "opencv-python-headless": "calibrate",
    "potpourri3d": "lesions",
    "pyoidn": "denoise",
    "ray": "scale",
    "scikit-image": "organs",
    "torch": "learn",
    "trimesh": "reports",
    "viser": "cockpit",
}
"""Packages that a wheel without extras does not install, and an extra of each."""


def test_everything_heavy_is_behind_an_extra_and_developers_have_all_extras() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    names = {extra: {re.split("[>=<;[ ]", line)[0] for line in extras[extra]} for extra in extras}
    base = {re.split("[>=<;[ ]", line)[0] for line in project["dependencies"]}
    assert not base & HEAVY.keys()
    for package, extra in HEAVY.items():
        assert package in names[extra]
    for extra in extras.keys() - {"docs"}:
        assert names[extra] - names["dev"] == set(), extra


def test_the_image_builds_with_the_declared_rust() -> None:
    crate = tomllib.loads((ROOT / "rust" / "Cargo.toml").read_text())["package"]
    image = re.search(r"^FROM rust:([\d.]+)-", (ROOT / "Dockerfile").read_text(), re.MULTILINE)
    assert image is not None
    assert image[1] == crate["rust-version"]


def test_the_image_copies_no_ignored_file() -> None:
    lines = (ROOT / "Dockerfile").read_text().splitlines()
    copied = {
        word
        for line in lines
        if line.startswith("COPY") and "--from" not in line
        for word in line.split()[1:-1]
    }
    allowed = (ROOT / ".dockerignore").read_text().splitlines()
    assert copied == {line[1:] for line in allowed if line.startswith("!")}
    assert all((ROOT / name).exists() for name in copied)


def test_a_release_builds_the_platforms_that_are_tested() -> None:
    def platforms(name: str) -> list[dict[str, str]]:
        steps = yaml.safe_load((ROOT / ".github" / "workflows" / name).read_text())
        return steps["jobs"]["wheel"]["strategy"]["matrix"]["include"]

    assert platforms("release.yml") == platforms("ci.yml")
    assert len(platforms("release.yml")) == 5


def test_citation_and_archive_agree_with_the_package() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    archive = json.loads((ROOT / ".zenodo.json").read_text())
    assert citation["license"] == archive["license"] == "Apache-2.0"
    assert citation["version"] == vrcaps.__version__
    (paper,) = citation["references"]
    assert [one["identifier"] for one in archive["related_identifiers"]] == [paper["doi"]]


def without_compilers(path: str) -> str:
    """The search path without the folders that hold cargo or rustc."""
    folders = path.split(os.pathsep)
    tools = ("cargo", "rustc")
    return os.pathsep.join(f for f in folders if not any((Path(f) / t).exists() for t in tools))


@pytest.mark.wheel
def test_wheel_records_the_demo_in_a_clean_environment(tmp_path: Path) -> None:
    (wheel,) = (ROOT / "dist").glob("vrcaps-*.whl")
    assert "-abi3-" in wheel.name
    venv.create(tmp_path / "venv", with_pip=True)
    scripts = tmp_path / "venv" / ("Scripts" if os.name == "nt" else "bin")
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "VIRTUAL"))}
    environment["PATH"] = without_compilers(environment["PATH"])

    def run(program: str, *args: str | Path) -> None:
        command = [scripts / program, *args]
        subprocess.run(command, cwd=tmp_path, env=environment, check=True, timeout=WATCHDOG)

    run("python", "-m", "pip", "install", "--quiet", "--only-binary=:all:", wheel)
    run("vrcaps", "demo", "--out", "demo")
    run("vrcaps", "check", "demo")
    assert (tmp_path / "demo" / "sheet.png").stat().st_size > 0
