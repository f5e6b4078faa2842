"""BOP: the rules of its toolkit, from the written files alone, give the written masks and boxes."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from tests.support.exported import assert_same_depth, assert_same_images, round_trip
from tests.support.oracle_embree import EmbreeCaster
from vrcaps.camera.camera import pixel_grid
from vrcaps.camera.lens import LensPinhole
from vrcaps.core.errors import InputError
from vrcaps.formats.detection import lesion_models
from vrcaps.formats.detection.bop import Bop
from vrcaps.formats.io import export
from vrcaps.mesh.polygon_files import read_ply
from vrcaps.recording.frame_files import read_image


@pytest.fixture(scope="module")
def sequence(pinhole_episode):
    """The tube with its ring of a lesion listed, which the capsule flies through."""
    lesions = [{"instance": 1, "kind": "colitis", "grade": "1"}]
    head = {**pinhole_episode.head, "organ": {**pinhole_episode.head["organ"], "lesions": lesions}}
    return replace(pinhole_episode, head=head).sequence()


@pytest.fixture(scope="module")
def written(sequence, tmp_path_factory):
    out = tmp_path_factory.mktemp("bop") / "out"
    return export(Bop(), [replace(sequence, split="test")], out)


def rows_of(place):
    """Camera, true pose and info of each object in each image, with its masks and the depth."""
    names = ("scene_camera", "scene_gt", "scene_gt_info")
    cameras, truths, infos = (json.loads((place / f"{name}.json").read_text()) for name in names)
    for key, camera in cameras.items():
        depth = read_image(place / f"depth/{int(key):06d}.png") * camera["depth_scale"]
        for number, (truth, info) in enumerate(zip(truths[key], infos[key], strict=True)):
            name = f"{int(key):06d}_{number:06d}.png"
            masks = [read_image(place / kind / name) > 0 for kind in ("mask", "mask_visib")]
            yield camera, truth, info, masks, depth


def pose_of(truth):
    return np.reshape(truth["cam_R_m2c"], (3, 3)), np.array(truth["cam_t_m2c"])


def distances(depth, matrix):
    """Distance of each pixel's point from the camera, as the toolkit makes it of depth."""
    plane = (pixel_grid(*depth.shape[::-1]) - matrix[:2, 2]) / np.diag(matrix)[:2]
    return depth * np.sqrt((plane**2).sum(axis=-1) + 1.0)


def test_masks_are_those_of_the_toolkit(written):
    """`mask`: where the model by itself is; `mask_visib`: where nothing is 0.3 mm before it.

    The model is drawn by Embree, from the PLY file; its rays may pass an edge by rounding.
    """
    rows = list(rows_of(written / "test/000000"))
    assert len(rows) >= 2
    for camera, truth, info, (mask, visible), depth in rows:
        mesh = read_ply(written / f"models/obj_{truth['obj_id']:06d}.ply")
        rotation, translation = pose_of(truth)
        points = mesh.vertices @ rotation.T + translation
        matrix = np.reshape(camera["cam_K"], (3, 3))
        grid = pixel_grid(*depth.shape[::-1]).reshape(-1, 2)
        rays = np.column_stack([grid, np.ones(len(grid))]) @ np.linalg.inv(matrix).T
        z, face, _ = EmbreeCaster(points, mesh.faces).cast(np.zeros_like(rays), rays)
        alone = np.where(face >= 0, z, 0.0).reshape(depth.shape)
        assert ((alone > 0.0) != mask).mean() < 2e-3
        near = distances(alone, matrix) - distances(depth, matrix) <= 0.3
        rule = (alone > 0.0) & (near | (depth == 0.0))
        assert (rule != visible).mean() < 5e-3
        assert info["px_count_visib"] == visible.sum()
        assert info["px_count_valid"] == (depth[mask] > 0.0).sum()
        assert info["px_count_all"] >= mask.sum()
        assert info["visib_fract"] == visible.sum() / info["px_count_all"]
        if visible.any():
            y, x = np.nonzero(visible)
            box = [x.min(), y.min(), x.max() - x.min(), y.max() - y.min()]
            assert info["bbox_visib"] == box


def test_model_points_fall_on_the_visible_pixels(written):
    """Middles of faces that the depth shows lie on pixels of `mask_visib`."""
    shown = 0
    for camera, truth, _, (_, visible), depth in rows_of(written / "test/000000"):
        mesh = read_ply(written / f"models/obj_{truth['obj_id']:06d}.ply")
        rotation, translation = pose_of(truth)
        points = mesh.vertices[mesh.faces].mean(axis=1) @ rotation.T + translation
        points = points[points[:, 2] > 1.0]
        pixels = points @ np.reshape(camera["cam_K"], (3, 3)).T
        at = np.rint(pixels[:, :2] / pixels[:, 2:]).astype(int)
        inside = ((at >= 1) & (at < np.array(depth.shape[::-1]) - 1)).all(axis=1)
        at, z = at[inside], points[inside, 2]
        seen = np.abs(depth[at[:, 1], at[:, 0]] - z) < 0.02 * z
        around = [visible[at[:, 1] + y, at[:, 0] + x] for x in (-1, 0, 1) for y in (-1, 0, 1)]
        assert np.any(around, axis=0)[seen].mean() > 0.95
        shown += seen.sum()
    assert shown > 50


def test_poses_and_models(sequence, written):
    """World to camera is that of the sequence; the model stands still in the world."""
    info = json.loads((written / "models/models_info.json").read_text())["1"]
    mesh = read_ply(written / "models/obj_000001.ply")
    spread = np.linalg.norm(mesh.vertices[:, None] - mesh.vertices[None], axis=-1).max()
    np.testing.assert_allclose(info["diameter"], spread, rtol=2e-3)
    low, size = (np.array([info[f"{word}_{axis}"] for axis in "xyz"]) for word in ("min", "size"))
    np.testing.assert_allclose(mesh.vertices.min(axis=0), low, atol=1e-5)
    np.testing.assert_allclose(np.ptp(mesh.vertices, axis=0), size, atol=1e-5)
    places = []
    for camera, truth, *_ in rows_of(written / "test/000000"):
        rotation = np.reshape(camera["cam_R_w2c"], (3, 3))
        own, translation = pose_of(truth)
        places.append(
            [*(rotation.T @ (translation - camera["cam_t_w2c"])), *(rotation.T @ own).flat]
        )
    assert len(places) > 1
    np.testing.assert_allclose(places, [places[0]] * len(places), atol=1e-6)
    targets = json.loads((written / "test_targets_bop19.json").read_text())
    assert targets[0].keys() == {"im_id", "inst_count", "obj_id", "scene_id"}


def test_what_was_written_is_read(sequence, tmp_path):
    found = round_trip(Bop(), sequence, tmp_path / "out")
    assert (found.name, found.camera.lens) == (sequence.name, sequence.camera.lens)
    assert_same_images(found, sequence)
    assert_same_depth(found, sequence, 1e-5)
    same = [found.image("instance", k) == sequence.image("instance", k) for k in range(5)]
    assert np.mean(same) > 0.998


@pytest.mark.parametrize("number", [70_000, -1, 1.5])
def test_instance_numbers_are_whole_and_in_range(written, tmp_path, number):
    shutil.copytree(written, tmp_path / "out")
    path = tmp_path / "out/test/000000/scene_gt.json"
    truths = json.loads(path.read_text())
    for rows in truths.values():
        for row in rows:
            row["instance"] = number
    path.write_text(json.dumps(truths))
    (found,) = Bop().read(tmp_path / "out")
    with pytest.raises(InputError, match=rf"instance IDs in .* first is {number}\. Allowed"):
        for k in range(len(found)):
            found.image("instance", k)


def test_cameras_share_the_models_of_their_episode(sequence, tmp_path):
    out = export(Bop(), [sequence, replace(sequence, name="tube/again")], tmp_path / "out")
    assert [path.name for path in sorted((out / "models").glob("*.ply"))] == ["obj_000001.ply"]
    assert {one.name for one in Bop().read(out)} == {sequence.name, "tube/again"}
    assert not (out / "test_targets_bop19.json").exists()


def test_healthy_organ_has_no_objects(pinhole_episode, tmp_path):
    out = export(Bop(), [pinhole_episode.sequence()], tmp_path / "out")
    assert json.loads((out / "models/models_info.json").read_text()) == {}
    truths = json.loads((out / "train/000000/scene_gt.json").read_text())
    assert list(truths.values()) == [[]] * 5


def test_walls_that_move_are_no_rigid_objects(sequence, tmp_path):
    def load(channel, index):
        image = sequence.load(channel, index)
        return image + np.float32(1e-3) if channel == "depth" else image

    with pytest.raises(InputError, match=r"Lesion 1 of .* is 1 mm from .* the wall moves"):
        export(Bop(), [replace(sequence, load=load)], tmp_path / "out")
    assert not list(tmp_path.iterdir())


def test_what_bop_cannot_hold(sequence, fisheye_episode, tmp_path, monkeypatch):
    with pytest.raises(InputError, match=r"bop supports lenses of kind 'pinhole'.*--rectify"):
        export(Bop(), [fisheye_episode.sequence()], tmp_path / "out")
    bent = LensPinhole(fx=25.0, fy=24.0, cx=20.25, cy=17.5, k1=0.1)
    with pytest.raises(InputError, match="a pinhole with distortion"):
        camera = replace(sequence.camera, lens=bent)
        export(Bop(), [replace(sequence, camera=camera)], tmp_path / "out")
    with pytest.raises(InputError, match="is not of an episode of vrcaps"):
        export(Bop(), [replace(sequence, episode=None)], tmp_path / "out")
    mesh = replace(sequence.episode.organ, instance=None)
    monkeypatch.setattr(lesion_models, "read_stored_organ", lambda *_: mesh)
    with pytest.raises(InputError, match="no lesion IDs"):
        export(Bop(), [sequence], tmp_path / "out")
    with pytest.raises(InputError, match="depth_step_mm is 0"):
        Bop(depth_step_mm=0.0)


def test_damaged_scenes(written, tmp_path):
    with pytest.raises(InputError, match=r"contains no scene_camera\.json"):
        Bop().read(tmp_path)
    (tmp_path / "000000").mkdir()
    (tmp_path / "000000/scene_camera.json").write_text("{}")
    with pytest.raises(InputError, match="has no folder rgb"):
        Bop().read(tmp_path)
    image = (written / "test/000000/rgb/000000.png").read_bytes()
    (tmp_path / "000000/rgb").mkdir()
    (tmp_path / "000000/rgb/000000.png").write_bytes(image)
    with pytest.raises(InputError, match="is not a BOP file: '0' is missing"):
        Bop().read(tmp_path)
