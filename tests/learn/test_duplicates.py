"""Near-duplicates: copies of an image are found, other images are not taken for them."""

import io

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import gaussian_filter

from tests.support.small_frames import small_sequence
from vrcaps import cli
from vrcaps.core.errors import InputError
from vrcaps.learn.networks import Backbone
from vrcaps.learn.samples import NEAR, Samples, image_hash, near_duplicates, without_duplicates
from vrcaps.learn.tasks.depth import DepthTask
from vrcaps.recording.frame_files import write_images

COUNT, HEIGHT, WIDTH = 24, 96, 120


def _image(seed, shift=0.0):
    """A smooth random wall with a dark lumen and black corners, as endoscopes show it."""
    chance = np.random.default_rng(seed)
    relief = gaussian_filter(chance.normal(size=(HEIGHT, WIDTH)), 4.0, mode="wrap")
    relief = np.roll(relief, round(shift * WIDTH), axis=1)
    y, x = np.mgrid[:HEIGHT, :WIDTH] / [[[HEIGHT]], [[WIDTH]]] - 0.5
    level = 150.0 - 90.0 * np.exp(-20.0 * (x**2 + y**2)) + 400.0 * relief
    level[x**2 + y**2 > 0.24] = 0.0
    return np.clip(level[..., None] * [1.0, 0.6, 0.5], 0, 255).astype(np.uint8)


def _compressed(image, quality):
    file = io.BytesIO()
    Image.fromarray(image).save(file, "JPEG", quality=quality)
    return np.asarray(Image.open(file))


def _resized(image, width, height):
    return np.asarray(Image.fromarray(image).resize((width, height), Image.Resampling.BILINEAR))


def _exposed(image):
    return np.clip(255.0 * 1.2 * (image / 255.0) ** 1.1, 0, 255).astype(np.uint8)


COPIES = {
    "same": lambda image: image,
    "mirrored": lambda image: image[:, ::-1],
    "upside down": lambda image: image[::-1],
    "turned": np.rot90,
    "transposed": lambda image: image.transpose(1, 0, 2),
    "smaller": lambda image: _resized(image, 60, 48),
    "squeezed": lambda image: _resized(image, 96, 96),
    "compressed": lambda image: _compressed(image, 20),
    "exposed": _exposed,
    "all": lambda image: _compressed(_resized(_exposed(image[:, ::-1]), 72, 72), 40),
}


def _hashes(images):
    return np.array([image_hash(np.ascontiguousarray(image)) for image in images])


@pytest.fixture(scope="module")
def originals():
    return [_image(seed) for seed in range(COUNT)]


@pytest.mark.parametrize("name", COPIES)
def test_a_copy_is_found_and_is_of_its_original(originals, name):
    order = np.random.default_rng(0).permutation(COUNT)
    copies = [COPIES[name](originals[k]) for k in order]
    pairs = near_duplicates(_hashes(originals), _hashes(copies))
    np.testing.assert_array_equal(pairs, np.stack([order, np.arange(COUNT)], axis=1))


def test_other_images_are_not_taken_for_copies(originals):
    others = [_image(seed) for seed in range(COUNT, 4 * COUNT)]
    assert len(near_duplicates(_hashes(originals), _hashes(others))) == 0
    assert len(near_duplicates(_hashes(originals), _hashes(others), near=0.5)) == 3 * COUNT


def test_frames_of_a_moving_camera_are_not_taken_for_copies():
    """The wall turns by a twentieth of the image from frame to frame."""
    frames = _hashes([_image(0, 0.05 * k) for k in range(20)])
    for k in range(20):
        assert len(near_duplicates(np.delete(frames, k, axis=0), frames[k : k + 1])) == 0


def test_nothing_is_a_near_duplicate_of_nothing(originals):
    empty = np.zeros((0, 16, 16), np.int8)
    assert near_duplicates(empty, _hashes(originals[:1])).shape == (0, 2)
    assert near_duplicates(_hashes(originals[:1]), empty).shape == (0, 2)
    assert 0.0 < NEAR < 0.25


def _samples(name, images):
    def load(channel, index):
        if images[index] is None:
            raise InputError(f"Cannot read {name}.")
        return images[index]

    sequence = small_sequence(name=name)
    values = {"time": np.arange(len(images), dtype=float)}
    for field, value in (("load", load), ("values", values)):
        object.__setattr__(sequence, field, value)
    return Samples(DepthTask(backbone=Backbone(32)), [(sequence, k) for k in range(len(images))])


@pytest.fixture
def photos(tmp_path, originals):
    """Folders of training and validation images that share a mirrored one."""
    parts = {"train": originals[:3], "val": [originals[1][:, ::-1], originals[7]]}
    for part, images in parts.items():
        (tmp_path / "photos" / part).mkdir(parents=True)
        files = [(tmp_path / "photos" / part / f"{k}.png", one) for k, one in enumerate(images)]
        write_images([(path, np.ascontiguousarray(image)) for path, image in files])
    return tmp_path / "photos"


@pytest.mark.slow
def test_command_reports_dropped_images(photos, tmp_path, capsys):
    pytest.importorskip("torch", reason="PyTorch is not installed")
    task = ["train", "super-resolution", "--size", "32", "--blocks", "1", "--features", "8"]
    task += ["--data", f"images:{photos}", "--set", "steps=1", "--set", "batch=1"]
    with pytest.raises(
        InputError, match=r"1 training images are near-duplicates .* train, frame 1 is val, fra"
    ):
        cli._parse([*task, "--out", str(tmp_path / "a"), "--duplicates", "refuse"]).run()
    assert not (tmp_path / "a").exists()
    cli.main([*task, "--out", str(tmp_path / "a")])
    said = capsys.readouterr().out
    assert "Dropped train, frame 1: duplicate of val, frame 0." in said
    assert "2 training frames, 2 validation frames" in said
    cli.main([*task, "--out", str(tmp_path / "b"), "--duplicates", "keep"])
    assert "3 training frames, 2 validation frames" in capsys.readouterr().out


def test_training_leaves_out_what_it_is_tested_with(originals):
    test = _samples("test", [None, originals[5], originals[2]])
    train = _samples("train", [*(COPIES["all"](one) for one in originals[:4]), None])
    left, found = without_duplicates(train, test)
    assert found == {"train, frame 2": "test, frame 2"}
    assert [index for _, index in left.frames] == [0, 1, 3, 4]
    assert without_duplicates(left, test) == (left, {}) or not without_duplicates(left, test)[1]
    with pytest.raises(
        InputError, match=r"All 1 training frames are near-duplicates .* is test, frame 1\. Give"
    ):
        without_duplicates(_samples("train", [originals[5][::-1]]), test)


def test_polyps_of_two_public_data_sets_are_the_same_pictures(shared_data):
    """Each image of Kvasir-SEG is in HyperKvasir, at 256 x 256 pixels; no two are taken for one."""
    real = shared_data / "real"
    small = sorted(real.glob("hyperkvasir_256/*/polyp/*.jpg"))
    large = sorted(real.glob("kvasir_seg/*/images/*.jpg"))[::25]
    known, asked = (_hashes(np.asarray(Image.open(p)) for p in part) for part in (small, large))
    pairs = near_duplicates(known, asked)
    assert list(pairs[:, 1]) == list(range(len(large)))
    assert len(set(pairs[:, 0])) == len(large)
    others = np.delete(known, pairs[:, 0], axis=0)
    assert len(near_duplicates(others, asked)) == 0
