"""`vrcaps calibrate geometric`: what it writes and says, and how mistakes end."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from failing import fail
from vrcaps import cli
from vrcaps.camera.lens import LensPinhole
from vrcaps.capsule.device_file import read_device
from vrcaps.core.transforms import transform_from
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
    assert "Boardfoundin6of7photographs." in text
    assert "Notfoundin:none.png." in text
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
    assert "exists. Give another --out, or --overwrite" in fail(arguments(photos, out), capsys)
    cli.main([*arguments(photos, out, capsule="pillcam-colon2", camera="back"), "--overwrite"])
    assert out.read_bytes() == before


@pytest.mark.slow
def test_mistakes_end_in_one_line(photos, tmp_path, capsys) -> None:
    out, empty = tmp_path / "mine.toml", tmp_path / "empty"
    empty.mkdir()

    def error(folder: Path = photos, path: Path = out, **changes: str) -> str:
        return fail(arguments(folder, path, **changes), capsys)

    assert "for example 7x8" in error(board="seven")
    assert "Allowed: 4 to 100 squares" in error(board="2x2")
    assert "Unknown length unit '2'" in error(square="2")
    assert "needs a positive number" in error(square="-2mm")
    assert "Allowed: a file name that ends in .toml" in error(path=tmp_path / "mine")
    assert "There is no folder" in error(path=tmp_path / "gone" / "mine.toml")
    assert "No capsule named 'mine'. Known: colonoscope, dual" in error(capsule="mine")
    assert "No camera of mirocam named 'back'. Known: front" in error(camera="back")
    assert "holds no photograph" in error(empty)
    assert "is seen in 1 of 1 photographs. Allowed: 3 or more" in error(photos / "0.png")
    assert "terms of pinhole is 9. Allowed: 0 to 3" in error(terms="9")
    assert not out.exists()
