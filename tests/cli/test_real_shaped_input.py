"""Input shaped like the real: a scanned mesh with its defects and a capsule from photographs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from scipy.spatial.transform import Rotation

from vrcaps import cli
from vrcaps.camera.camera import Camera
from vrcaps.camera.lens import LensPinhole
from vrcaps.core.geometry import transform_from
from vrcaps.organ.read_organ import read_organ
from vrcaps.tools.camera_calibration.board import Board, board_image

pytestmark = pytest.mark.slow


def write_scan(path: Path) -> None:
    """A bent bag [mm] as scanners give it: noise, holes, doubled and turned faces, a speck."""
    rng = np.random.default_rng(0)
    bag = trimesh.creation.capsule(40.0, 12.0, count=[24, 24])
    vertices, faces = np.array(bag.vertices), np.array(bag.faces)
    vertices[:, 0] += 8.0 * np.sin(vertices[:, 2] / 30.0)
    vertices += 0.05 * rng.standard_normal(vertices.shape)
    turned = rng.random(len(faces)) < 0.05
    faces[turned] = faces[turned, ::-1]
    faces = np.delete(faces, [300, 301, 600], axis=0)
    faces = np.concatenate([faces, faces[500:510]])
    speck = trimesh.creation.icosphere(1, 0.5)
    soup = np.concatenate([vertices[faces], speck.triangles + 40.0])
    corners = np.arange(3 * len(soup)).reshape(-1, 3)
    trimesh.Trimesh(soup.reshape(-1, 3), corners, process=False).export(path)


def write_photographs(folder: Path, camera: Camera) -> None:
    """Four of a tilted chessboard of 5 × 6 squares of 2 mm, with grain, and four of nothing."""
    board, rng = Board(5, 6, 2e-3), np.random.default_rng(1)
    folder.mkdir()
    for k, tilt in enumerate([(0.4, 0.0), (-0.4, 0.1), (0.0, 0.5), (0.1, -0.5)]):
        rotation = Rotation.from_rotvec([*tilt, 0.2 * k]).as_matrix()
        place = np.array([0.001 * (k - 2), 0.0, 0.013]) - rotation @ board.points.mean(axis=0)
        image = 220.0 * board_image(camera, transform_from(rotation, place), board, 4) + 10.0
        image += rng.normal(0.0, 2.0, image.shape)
        pixels = np.rint(image.clip(0, 255)).astype(np.uint8)
        Image.fromarray(pixels).save(folder / f"{k}.jpg", quality=92)
        Image.fromarray(np.full_like(pixels, 90)).save(folder / f"none{k}.jpg")


def test_a_scanned_mesh_records_with_a_calibrated_capsule(tmp_path, capsys) -> None:
    scan, photos, capsule = tmp_path / "scan.stl", tmp_path / "photos", tmp_path / "mine.toml"
    write_scan(scan)
    lens = LensPinhole(90.0, 90.0, 79.5, 79.5)
    write_photographs(photos, Camera(name="front", lens=lens, width=160, height=160, leds=()))
    flags = ["--board", "5x6", "--square", "2mm", "--lens", "pinhole", "--terms", "1"]
    cli.main(["calibrate", "geometric", str(photos), *flags, "--out", str(capsule)])
    run = tmp_path / "run"
    flags = ["--unit", "mm", "--capsule", str(capsule), "--frames", "2", "--light", "direct"]
    cli.main(["record", "--organ", str(scan), *flags, "--out", str(run)])
    cli.main(["check", str(run)])
    text = " ".join(capsys.readouterr().out.split())
    assert "Detected the board in 4 of 8 photographs." in text
    assert "Warning: half of the photographs or more are left out." in text
    repairs = " ".join(read_organ(run / "organ.glb").metadata["repairs"])
    for defect in ("duplicate triangle", "stray component", "flipped triangle", "hole"):
        assert defect in repairs
    assert len(list((run / "front").glob("rgb/*.png"))) == 2
