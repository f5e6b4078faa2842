"""The five programs of the quickstart run, and each is short."""

from __future__ import annotations

import ast
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

import vrcaps
from tests.support.coarse_organs import ATLAS
from tests.support.tubes import straight_gut
from vrcaps.organ.read_organ import read_organ

PAGE = Path(__file__).resolve().parents[1] / "docs" / "tutorials" / "quickstart.md"
MAX_STATEMENTS = 6


def programs() -> list[str]:
    """The first five programs of the section."""
    _, section = PAGE.read_text(encoding="utf-8").split("## Five programs in Python\n")
    return re.findall(r"```python\n(.*?)```", section.split("\n## ")[0], re.DOTALL)[:5]


def run(program: str) -> dict[str, Any]:
    names: dict[str, Any] = {"np": np, "vrcaps": vrcaps}
    exec(compile(program, str(PAGE), "exec"), names)
    return names


@pytest.fixture
def folder(tmp_path: Path, coarse_organs: None, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("vrcaps.organ.uv._RESOLUTION", ATLAS)
    return tmp_path


@pytest.mark.parametrize("program", programs())
def test_a_program_has_six_statements_at_most(program: str):
    statements = [node for node in ast.walk(ast.parse(program)) if isinstance(node, ast.stmt)]
    assert len(statements) <= MAX_STATEMENTS


@pytest.mark.slow
def test_renders_a_frame_of_a_mesh_file(folder: Path):
    gut = straight_gut({"colon": 0.2}, radius=0.02)
    trimesh.Trimesh(1e3 * gut.vertices, gut.faces, process=False).export(folder / "colon.ply")
    frame = run(programs()[0])["frame"]
    assert frame.rgb.shape == (*frame.depth.shape, 3)
    assert np.nanmin(frame.depth) > 0.0


@pytest.mark.slow
def test_writes_a_mesh_file(folder: Path, monkeypatch: pytest.MonkeyPatch):
    """The mesh of the page is read, in large voxels, as the organ that it was written from."""
    monkeypatch.setattr("vrcaps.organ.centerline._MAX_INSIDE", 200_000)
    text = PAGE.read_text(encoding="utf-8").split("## Your own organ\n")[1]
    organ = run(re.findall(r"```python\n(.*?)```", text, re.DOTALL)[0])["organ"]
    read = read_organ(Path("colon.ply"), unit="mm")
    assert read.centerline.length == pytest.approx(organ.centerline.length, rel=0.02)
    np.testing.assert_allclose(np.ptp(read.vertices, 0), np.ptp(organ.vertices, 0), rtol=1e-3)


@pytest.mark.slow
def test_records_an_episode_and_loads_it_as_arrays(folder: Path):
    short = programs()[1].replace("frames=100", "frames=2")
    assert short != programs()[1]
    run(short)
    names = run(programs()[3])
    assert names["depth"].shape[0] == names["poses"].shape[0] == 2
    assert names["poses"].shape[1:] == (4, 4)
    item = names["episode"][-1]
    assert set(item) > {"rgb", "depth", "T_world_camera", "T_world_capsule", "time", "index"}
    assert all(isinstance(value, np.ndarray) for value in item.values())
    np.testing.assert_array_equal(item["depth"], names["depth"][-1])
    with pytest.raises(IndexError, match="No frame 2"):
        names["sequence"][2]
    with pytest.raises(vrcaps.VrcapsError, match="No channel named 'normal'"):
        names["episode"].sequence("front", ("normal",))


@pytest.mark.slow
def test_steps_a_world_with_a_magnet(folder: Path):
    names = run(programs()[2])
    assert names["world"].time == pytest.approx(0.1)
    assert names["world"].coupling.distance < 0.4
    assert names["frame"].rgb.any()


@pytest.mark.slow
def test_describes_a_capsule(folder: Path):
    names = run(programs()[4])
    assert names["frame"].rgb.shape == (256, 256, 3)
    assert names["frame"].rgb.any()


def test_exported_classes_show_a_call():
    classes = [getattr(vrcaps, name) for name in vrcaps.__all__]
    classes = [c for c in classes if isinstance(c, type) and not issubclass(c, Exception)]
    without = [c.__name__ for c in classes if "Example:" not in (c.__doc__ or "")]
    assert set(without) <= {"Frame"}
