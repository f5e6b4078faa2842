"""Folders of images: written and read, by class or with masks; layouts of real data."""

from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from tests.support.ellipsoid_sequence import ellipsoid_sequence
from tests.support.write_any import write_image
from vrcaps.camera.lens import LensPinhole
from vrcaps.core.errors import InputError
from vrcaps.formats.detection.image_folders import Images
from vrcaps.formats.io import export
from vrcaps.formats.shared.stored_images import stored_steps

LENS = LensPinhole(fx=25.0, fy=24.0, cx=20.25, cy=17.5)
LESIONS = [{"instance": 1, "kind": "polyp"}, {"instance": 2, "kind": "ulcer"}]


@pytest.fixture
def sequence():
    """Frames: no lesion; a speck; a polyp; an ulcer larger than a polyp; a polyp."""
    plain = ellipsoid_sequence(LENS, 40, 36)

    def load(channel, index):
        if channel != "instance":
            return plain.load(channel, index)
        instance = np.zeros((36, 40), np.uint16)
        instance[0, :3] = 1 if index == 1 else 0
        instance[:9] = 1 if index >= 2 else instance[:9]
        instance[9:30] = 2 if index == 3 else 0
        return instance

    episode = SimpleNamespace(head={"organ": {"lesions": LESIONS}})
    return replace(plain, channels=("rgb", "label", "instance"), load=load, episode=episode)


@pytest.mark.parametrize("masks", ["auto", "binary", "numbers"])
def test_masks_that_were_written_are_read(sequence, tmp_path, masks):
    form = Images(masks=masks)
    (found,) = form.read(export(form, [sequence], tmp_path / "out"))
    numbers = masks == "numbers"
    names = ("background", "left", "right") if numbers else ("background", "lesion")
    assert found.label_names == names
    for k in range(len(sequence)):
        np.testing.assert_array_equal(found.image("rgb", k), sequence.image("rgb", k))
        truth = sequence.image("label", k) if numbers else sequence.image("instance", k) > 0
        np.testing.assert_array_equal(found.image("label", k), truth)
    mask = cv2.imread(str(tmp_path / "out/masks/ball_front_000002.png"), cv2.IMREAD_UNCHANGED)
    assert set(np.unique(mask)) == ({1, 2} if numbers else {0, 255})


def test_a_frame_has_the_class_of_its_largest_lesion(sequence, tmp_path):
    parts = [replace(sequence, name="a", split="train"), replace(sequence, name="b", split="test")]
    form = Images(layout="classes")
    out = export(form, parts, tmp_path / "out")
    found = {path.relative_to(out).as_posix() for path in (out / "train").rglob("*.png")}
    assert found == {
        "train/normal/a_000000.png",
        "train/polyp/a_000002.png",
        "train/ulcer/a_000003.png",
        "train/polyp/a_000004.png",
    }
    read = {one.name: one for one in form.read(out)}
    assert read["test/polyp"].split == "test"
    assert list(read["test/polyp"].values["class"]) == ["polyp", "polyp"]
    assert read["train/normal"].channels == ("rgb",)
    np.testing.assert_array_equal(read["train/ulcer"].image("rgb", 0), sequence.image("rgb", 3))


def test_a_smaller_share_gives_the_speck_its_class(sequence, tmp_path):
    out = export(Images(layout="classes", min_fraction=0.0), [sequence], tmp_path / "out")
    assert (out / "polyp" / "ball_front_000001.png").exists()


def test_images_of_any_size_have_masks_of_any_kind(tmp_path):
    """As Kvasir-SEG: JPEG, each of another size, and masks as JPEG with its noise."""
    rng = np.random.default_rng(0)
    for name, size in (("cju9", (30, 40)), ("cju10", (22, 26))):
        write_image(tmp_path / f"val/images/{name}.jpg", rng.integers(0, 255, (*size, 3), np.uint8))
        mask = np.zeros((*size, 3), np.uint8)
        mask[5:15, 5:20] = 255
        write_image(tmp_path / f"val/masks/{name}.jpg", mask)
    (found,) = Images(fps=2.0).read(tmp_path)
    assert (found.name, found.split, found.camera) == ("val/images", "val", None)
    np.testing.assert_allclose(found.times, [0.0, 0.5])
    assert found.image("rgb", 0).shape == (30, 40, 3)  # cju9 before cju10
    label = found.image("label", 1)
    assert label.shape == (22, 26)
    assert set(np.unique(label)) == {0, 1}
    assert label[5:15, 5:20].mean() > 0.95


def test_numbers_of_classes_are_read_as_they_are(tmp_path):
    """As BKAI-IGH NeoPolyp: 1 and 2; all that `auto` may take for binary is above 127."""
    mask = np.array([[0, 1, 2], [127, 0, 0]], np.uint8)
    write_image(tmp_path / "images/a.jpeg", np.zeros((2, 3, 3), np.uint8))
    write_image(tmp_path / "masks/a.png", mask)
    (found,) = Images().read(tmp_path)
    np.testing.assert_array_equal(found.image("label", 0), mask)
    (found,) = Images(masks="binary").read(tmp_path)
    assert not found.image("label", 0).any()
    write_image(tmp_path / "masks/a.png", mask + np.uint8(100))
    (found,) = Images(masks="numbers").read(tmp_path)
    np.testing.assert_array_equal(found.image("label", 0), mask + 100)


def test_masks_beside_a_class_bear_its_name(tmp_path):
    """As WCEBleedGen: `bleeding`, `bleeding_mask`, `non_bleeding`."""
    for folder in ("bleeding", "non_bleeding"):
        write_image(tmp_path / "train" / folder / "1.png", np.zeros((4, 4, 3), np.uint8))
    write_image(tmp_path / "train/bleeding_mask/1_mask.png", np.eye(4, dtype=np.uint8) * 255)
    first, second = Images().read(tmp_path)
    assert (first.name, first.label_names) == ("train/bleeding", ("background", "bleeding"))
    np.testing.assert_array_equal(first.image("label", 0), np.eye(4))
    assert list(first.values["class"]) == ["bleeding"]
    assert (second.name, second.channels, second.label_names) == (
        "train/non_bleeding",
        ("rgb",),
        (),
    )


def test_frames_of_a_video_are_in_the_order_of_their_numbers(tmp_path):
    for number in (1, 2, 10):
        write_image(tmp_path / f"{number}.bmp", np.full((3, 3, 3), number, np.uint8))
    (found,) = Images(fps=25.0).read(tmp_path)
    assert [int(found.image("rgb", k)[0, 0, 0]) for k in range(3)] == [1, 2, 10]
    assert "class" not in found.values
    assert found.name == tmp_path.name


def test_gray_palette_and_one_bit_images_are_read(tmp_path):
    from PIL import Image

    (tmp_path / "images").mkdir()
    (tmp_path / "masks").mkdir()
    colors = Image.fromarray(np.array([[[255, 0, 0], [0, 255, 0]]], np.uint8))
    colors.quantize(4).save(tmp_path / "images" / "a.png")
    Image.fromarray(np.array([[9, 200]], np.uint8)).save(tmp_path / "images" / "b.png")
    palette = Image.fromarray(np.array([[0, 2]], np.uint8), "P")
    palette.putpalette([0, 0, 0, 9, 9, 9, 200, 0, 0])
    palette.save(tmp_path / "masks" / "a.png")
    Image.fromarray(np.array([[0, 255]], np.uint8)).convert("1").save(tmp_path / "masks" / "b.png")
    (found,) = Images().read(tmp_path)
    np.testing.assert_array_equal(found.image("rgb", 0), [[[255, 0, 0], [0, 255, 0]]])
    np.testing.assert_array_equal(found.image("rgb", 1), [[[9] * 3, [200] * 3]])
    np.testing.assert_array_equal(found.image("label", 0), [[0, 2]])
    np.testing.assert_array_equal(found.image("label", 1), [[0, 1]])


def test_what_does_not_fit_is_one_clear_line(sequence, tmp_path):
    plain = sequence.with_channels(["rgb"])
    for form in (Images(), Images(masks="binary"), Images(layout="classes")):
        with pytest.raises(InputError, match=r"images requires the channel .*--channels rgb "):
            export(form, [plain], tmp_path / "out")
    with pytest.raises(InputError, match="ball/front is not from one"):
        export(Images(layout="classes"), [replace(sequence, episode=None)], tmp_path / "out")
    other = replace(sequence, name="other", label_names=("background", "wall"))
    with pytest.raises(InputError, match=r"have 2 lists of classes.*--masks binary"):
        export(Images(masks="numbers"), [sequence, other], tmp_path / "out")
    with pytest.raises(InputError, match=r"contains no images. Allowed: .png"):
        Images().read(tmp_path)


def test_damage_is_one_clear_line(sequence, tmp_path):
    out = export(Images(), [sequence], tmp_path / "out")
    (found,) = Images(masks="numbers").read(out)
    write_image(out / "masks/ball_front_000000.png", np.full((36, 40), 300, np.uint16))
    with pytest.raises(InputError, match=r"the first is 300\. Allowed: .* from 0 to 255"):
        found.image("label", 0)
    (out / "images/ball_front_000000.png").write_bytes(b"no image")
    with pytest.raises(InputError, match=r"Cannot read .*000000.png"):
        found.image("rgb", 0)
    (out / "masks/ball_front_000003.png").unlink()
    with pytest.raises(InputError, match=r"masks of ball_front_000003.png and 0 more"):
        Images().read(out)


@pytest.mark.parametrize(
    ("dtype", "given", "stored"),
    [
        (np.uint16, [0.4, 1.5, 65_535.4, 65_536.0, -1.0], [0, 2, 65_535, 0, 0]),
        (np.uint16, [np.nan, np.inf, -np.inf, 1e30, -0.4], [0, 0, 0, 0, 0]),
        (np.uint8, [254.6, 255.0, 256.0], [255, 255, 0]),
    ],
)
def test_steps_beyond_a_type_are_no_value(dtype, given, stored):
    found = stored_steps(np.array(given), dtype)
    assert (found.dtype, found.tolist()) == (dtype, stored)
