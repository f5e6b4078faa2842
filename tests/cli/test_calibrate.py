"""Camera calibration from the command line."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage
from scipy.spatial.transform import Rotation

from tests.support.failing import fail
from vrcaps import cli
from vrcaps.camera.lens import LensPinhole
from vrcaps.capsule.device_file import read_device
from vrcaps.core.geometry import transform_from
from vrcaps.scenario.scenario import read_scenario
from vrcaps.tools.camera_calibration.board import Board, board_image

BOARD = Board(5, 6, 2e-3)
CAMERA = replace(
    read_device("mirocam").cameras[0],
    lens=LensPinhole(90.0, 90.0, 79.5, 79.5, k1=-0.1),
    width=160,
    height=160,
    image_circle_px=78.0,
)


@pytest.fixture(scope="module")
def coarse_looks() -> None:
    """Images of the catalog are whole: a calibration scales its own to them."""


@pytest.fixture(scope="module")
def photos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of six pictures of a tilted board, and one of nothing."""
    folder = tmp_path_factory.mktemp("photos")
    tilts = [(0.4, 0.0), (-0.4, 0.1), (0.0, 0.5), (0.1, -0.5), (0.3, 0.3), (-0.3, -0.2)]
    for k, (x, y) in enumerate(tilts):
        rotation = Rotation.from_rotvec([x, y, 0.2 * k]).as_matrix()
        place = np.array([0.001 * (k - 3), 0.0005 * k, 0.012]) - rotation @ BOARD.points.mean(0)
        image = board_image(CAMERA, transform_from(rotation, place), BOARD, 4)
        Image.fromarray(np.rint(230.0 * image + 4.0).astype(np.uint8)).save(folder / f"{k}.png")
    Image.fromarray(np.full((160, 160), 90, np.uint8)).save(folder / "none.png")
    return folder


def arguments(photos: Path, out: Path, **changes: str) -> list[str]:
    flags = {"board": "5x6", "square": "2mm", "lens": "pinhole", **changes}
    words = [word for name, value in flags.items() for word in (f"--{name}", value)]
    return ["calibrate", "geometric", str(photos), *words, "--out", str(out)]


@pytest.mark.slow
def test_photographs_become_a_capsule_with_a_picture_of_residuals(photos, tmp_path, capsys) -> None:
    out = tmp_path / "mine.toml"
    cli.main(arguments(photos, out, capsule="pillcam-colon2", camera="back"))
    text = "".join(capsys.readouterr().out.split())  # the terminal's width breaks lines
    assert "Detectedtheboardin6of7photographs." in text
    assert "Notdetectedin:none.png." in text
    assert f"--capsule{out}--outRUN" in text
    device, pattern = read_device(out), read_device("pillcam-colon2")
    front, back = device.cameras
    assert front.lens == pattern.cameras[0].lens
    assert back.leds == pattern.cameras[1].leds
    assert (back.width, back.height) == (160, 160)
    assert isinstance(back.lens, LensPinhole)
    assert back.lens.fx == pytest.approx(90.0, rel=5e-3)
    assert back.image_circle_px == pytest.approx(78.0, abs=1.0)
    assert device.metadata["calibration"]["photographs"] == [f"{k}.png" for k in range(6)]
    assert (tmp_path / "mine.png").stat().st_size > 50_000
    assert "Warning" not in text
    before = out.read_bytes()
    assert "exists. Choose another --out, or pass --overwrite" in fail(
        arguments(photos, out), capsys
    )
    cli.main([*arguments(photos, out, capsule="pillcam-colon2", camera="back"), "--overwrite"])
    assert out.read_bytes() == before


@pytest.mark.slow
def test_mistakes_of_a_geometric_calibration_end_in_one_line(photos, tmp_path, capsys) -> None:
    out, empty = tmp_path / "mine.toml", tmp_path / "empty"
    empty.mkdir()

    def error(folder: Path = photos, path: Path = out, **changes: str) -> str:
        return fail(arguments(folder, path, **changes), capsys)

    assert "for example 7x8" in error(board="seven")
    assert "Allowed: 4 to 100 squares" in error(board="2x2")
    assert "Unknown length unit '2'" in error(square="2")
    assert "needs a positive number" in error(square="-2mm")
    assert "Allowed: a name that ends in .toml" in error(path=tmp_path / "mine")
    assert "does not exist. Create it first" in error(path=tmp_path / "gone" / "mine.toml")
    assert "No capsule named 'mine'. Known: colonoscope, dual" in error(capsule="mine")
    assert "No camera of mirocam named 'back'. Known: front" in error(camera="back")
    assert "contains no photograph" in error(empty)
    assert "is seen in 1 of 1 photographs. Allowed: 3 or more" in error(photos / "0.png")
    assert "terms of pinhole is 9. Allowed: 0 to 3" in error(terms="9")
    assert not out.exists()


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
    assert "exists. Choose another --out, or pass --overwrite" in fail(args, capsys)


def test_mistakes_of_a_photometric_calibration_end_in_one_line(folders, tmp_path, capsys) -> None:
    real, _ = folders
    out = ["--out", str(tmp_path / "mine.toml")]
    assert "1 frames are given. Allowed: 3 or more" in fail(
        ["calibrate", "photometric", str(real / "0.jpg"), *out], capsys
    )
    assert "Nothing at" in fail(["calibrate", "photometric", str(tmp_path / "gone"), *out], capsys)
    assert "No capsule named 'x'" in fail(
        ["calibrate", "photometric", str(real), "--capsule", "x", *out], capsys
    )
    bad = ["calibrate", "photometric", str(real), "--out", str(tmp_path / "mine.txt")]
    assert "Allowed: a name that ends in .toml" in fail(bad, capsys)
    assert not (tmp_path / "mine.toml").exists()
