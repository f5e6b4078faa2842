"""SC-SfMLearner's training tree: round trip, and the rules of its loader."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.support.ellipsoid_sequence import ellipsoid_sequence
from tests.support.exported import assert_same_depth, round_trip
from tests.support.write_any import write_image
from vrcaps.camera.lens import LensPinhole
from vrcaps.core.errors import InputError
from vrcaps.formats.endoscopy.sfmlearner import SfmLearner
from vrcaps.formats.io import export

LENS = LensPinhole(fx=25.0, fy=24.0, cx=20.25, cy=17.5)


@pytest.fixture
def sequence():
    return ellipsoid_sequence(LENS, 40, 36)


@pytest.mark.parametrize(("depth", "step"), [("npy", 1e-9), ("png", 2e-6), ("none", None)])
def test_what_was_written_is_read(sequence, tmp_path, depth, step):
    found = round_trip(SfmLearner(depth=depth), replace(sequence, split="val"), tmp_path / "out")
    assert found.camera.lens == LENS
    assert found.split == "val"
    error = found.image("rgb", 2).astype(float) - sequence.image("rgb", 2)
    assert np.abs(error).mean() < 3.0
    if step is None:
        assert found.channels == ("rgb",)
    else:
        assert_same_depth(found, sequence, step)


def test_loader_finds_the_frames_in_order(tmp_path):
    """It cuts the last letter of each line, sorts `*.jpg` as text and reads 3 rows of K."""
    lens = LensPinhole(fx=4.0, fy=4.0, cx=2.5, cy=1.5)
    frames = ellipsoid_sequence(lens, 6, 4, frames=12)
    parts = [replace(frames, name=n, split=s) for n, s in (("a", "train"), ("b", "val"))]
    parts.append(replace(frames, name="c", split="train"))
    out = export(SfmLearner(quality=100), parts, tmp_path / "out")
    with (out / "train.txt").open() as file:
        scenes = [out / line[:-1] for line in file]
    assert [scene.name for scene in scenes] == ["a", "c"]
    K = np.genfromtxt(scenes[1] / "cam.txt").reshape(3, 3)
    np.testing.assert_allclose(K, [[4.0, 0.0, 2.5], [0.0, 4.0, 1.5], [0.0, 0.0, 1.0]])
    images = sorted(str(path) for path in scenes[1].iterdir() if path.suffix == ".jpg")
    assert len(images) == 12
    for index, path in enumerate(images):
        error = cv2.imread(path)[..., ::-1].astype(float) - frames.image("rgb", index)
        assert np.abs(error).max() < 6.0


def test_depth_is_in_the_range_that_the_figures_count(sequence, tmp_path):
    place = export(SfmLearner(), [sequence], tmp_path / "out") / "ball_front"
    depth = np.load(place / "0000001.npy")
    assert depth.dtype == np.float32
    assert (depth > 0.1).all()
    assert (depth < 10.0).all()
    np.testing.assert_allclose(depth, 100 * sequence.image("depth", 1), rtol=1e-6)
    assert not (tmp_path / "out" / "val.txt").exists()


def test_real_trees_without_poses_are_read(tmp_path):
    (tmp_path / "scene").mkdir()
    (tmp_path / "scene" / "cam.txt").write_text("9,0,2,\n0,8,1.5,\n0,0,1\n")
    (tmp_path / "train.txt").write_text("scene")
    write_image(tmp_path / "scene" / "0000003.jpg", np.full((4, 5, 3), 9, np.uint8))
    np.save(tmp_path / "scene" / "0000003.npy", np.full((4, 5), 2.5))
    (found,) = SfmLearner(depth_unit="m", fps=10.0).read(tmp_path)
    assert (found.camera.lens.fy, found.split) == (8.0, "train")
    np.testing.assert_allclose(found.times, [0.3])
    np.testing.assert_allclose(found.image("depth", 0), 2.5)


def test_what_does_not_fit_is_one_clear_line(sequence, tmp_path):
    with pytest.raises(InputError, match=r"quality is 0. Allowed: 1 to 100"):
        SfmLearner(quality=0)
    out = export(SfmLearner(), [sequence], tmp_path / "out")
    for path in out.rglob("*.jpg"):
        path.rename(path.with_suffix(".png"))
    with pytest.raises(InputError, match=r"contains no \*.jpg"):
        SfmLearner().read(out)
