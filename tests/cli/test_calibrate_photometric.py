"""`vrcaps calibrate photometric`: what it writes and says, and how mistakes end."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage

from failing import fail
from vrcaps import cli
from vrcaps.capsule.device_file import read_device
from vrcaps.scenario.scenario import read_scenario


def write_frames(folder: Path, count: int, tint: tuple[float, float, float]) -> Path:
    """Pictures of mottled walls, 160 px, with a dark rim."""
    folder.mkdir()
    rows, columns = np.indices((160, 160))
    disc = np.hypot(columns - 79.5, rows - 79.5) <= 76.0
    for k in range(count):
        rng = np.random.default_rng(k)
        mottle = ndimage.gaussian_filter(rng.normal(size=(160, 160, 1)), (8, 8, 0), mode="wrap")
        light = 110.0 * np.exp(0.1 * mottle / mottle.std()) + rng.normal(0, 2, (160, 160, 3))
        rgb = np.clip(light * tint, 0, 255) * disc[..., None]
        Image.fromarray(rgb.astype(np.uint8)).save(folder / f"{k}.jpg", quality=90)
    return folder


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Real frames and the reference's."""
    root = tmp_path_factory.mktemp("frames")
    real = write_frames(root / "real", 6, (1.4, 0.9, 0.7))
    return real, write_frames(root / "plain", 6, (1.3, 0.9, 0.6))


@pytest.mark.slow
def test_frames_become_a_capsule_and_a_scenario(folders, tmp_path, capsys) -> None:
    real, plain = folders
    out = tmp_path / "mine.toml"
    args = ["calibrate", "photometric", str(real), "--reference", str(plain), "--out", str(out)]
    cli.main(args)
    text = "".join(capsys.readouterr().out.split())  # the terminal's width breaks lines
    assert "6framesof160×160px." in text
    assert "quality90" in text
    assert f"vrcapsrecord{tmp_path / 'mine-effects.toml'}--outRUN" in text
    (camera,), (old,) = read_device(out).cameras, read_device("mirocam").cameras
    assert camera.image_circle_px == pytest.approx(2.0 * 76.5, abs=2.0)
    assert camera.leds[0].intensity[0] > old.leds[0].intensity[0]
    assert camera.leds[0].intensity[1] == old.leds[0].intensity[1]
    assert camera.lens == old.lens
    scenario = read_scenario(tmp_path / "mine-effects.toml")
    assert scenario.capsule == str(out)
    assert scenario.effects.jpeg.quality == 90
    assert (tmp_path / "mine.png").stat().st_size > 50_000
    assert "exists. Give another --out, or --overwrite" in fail(args, capsys)


def test_mistakes_end_in_one_line(folders, tmp_path, capsys) -> None:
    real, _ = folders
    out = ["--out", str(tmp_path / "mine.toml")]
    assert "Frames given: 1. Allowed: 3 or more" in fail(
        ["calibrate", "photometric", str(real / "0.jpg"), *out], capsys
    )
    assert "Nothing at" in fail(["calibrate", "photometric", str(tmp_path / "gone"), *out], capsys)
    assert "No capsule named 'x'" in fail(
        ["calibrate", "photometric", str(real), "--capsule", "x", *out], capsys
    )
    bad = ["calibrate", "photometric", str(real), "--out", str(tmp_path / "mine.txt")]
    assert "Allowed: a file name that ends in .toml" in fail(bad, capsys)
    assert not (tmp_path / "mine.toml").exists()
