"""`vrcaps organ texture`: what it writes, and how mistakes end."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage

from tests.support import failing
from vrcaps import cli
from vrcaps.mucosa.texture import read_texture


@pytest.fixture(scope="module")
def frames(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two even pictures of mottled mucosa."""
    folder = tmp_path_factory.mktemp("frames")
    for seed in (0, 1):
        noise = np.random.default_rng(seed).normal(size=(96, 96, 3))
        mottle = ndimage.gaussian_filter(noise, (1.5, 1.5, 0.0), mode="wrap")
        rgb = np.clip([190, 110, 90] + 90.0 * mottle, 0, 255).astype(np.uint8)
        Image.fromarray(rgb).save(folder / f"{seed}.png")
    return folder


def run(args: list[str]) -> None:
    cli.main(["organ", "texture", *args])


def fail(args: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    return failing.fail(["organ", "texture", *args], capsys)


@pytest.mark.slow
def test_photographs_become_a_texture_with_a_report(frames, tmp_path, capsys) -> None:
    out = tmp_path / "mucosa"
    args = [str(frames), "--flat", "--mm-per-pixel", "0.1", "--size", "256"]
    run([*args, "--seed", "3", "--out", str(out)])
    text = "".join(capsys.readouterr().out.split())  # the terminal's width breaks lines
    assert "256×256texels,2.6cmwide" in text
    assert f"--mucosa{out}--outRUN" in text
    names = {path.name for path in out.iterdir()}
    assert names == {"albedo.png", "roughness.png", "height.png", "mucosa.json", "report.png"}
    texture = read_texture(out)
    assert texture.albedo.shape == (256, 256, 3)
    assert texture.texel == pytest.approx(1e-4)
    again = tmp_path / "again"
    run([*args, "--seed", "3", "--out", str(again)])
    for name in names - {"report.png"}:
        assert (out / name).read_bytes() == (again / name).read_bytes()


def test_mistakes_end_in_one_line(frames, tmp_path, capsys) -> None:
    empty, other = tmp_path / "empty", tmp_path / "other"
    empty.mkdir()
    other.mkdir()
    (other / "notes.txt").write_text("no picture")
    (tmp_path / "broken.png").write_text("no picture")
    Image.fromarray(np.full((30, 30, 3), 128, np.uint8)).save(tmp_path / "small.png")
    out = tmp_path / "mucosa"
    rest = ["--mm-per-pixel", "0.1", "--out", str(out)]
    assert "contains no photograph" in fail([str(empty), *rest], capsys)
    assert "contains no photograph" in fail([str(other), *rest], capsys)
    assert "Cannot read" in fail([str(tmp_path / "broken.png"), *rest], capsys)
    assert "Nothing at" in fail([str(tmp_path / "gone.png"), *rest], capsys)
    small = [str(tmp_path / "small.png"), *rest]
    assert "too few to make a texture from" in fail(small, capsys)
    assert "does not say its scale" in fail([str(frames), "--out", str(out)], capsys)
    assert "is not a texture" in fail([str(frames), *rest[:2], "--out", str(other)], capsys)
    assert "Allowed: " in fail([str(frames), *rest, "--flat", "--size", "20"], capsys)
    assert not out.exists()
    assert (other / "notes.txt").read_text() == "no picture"
