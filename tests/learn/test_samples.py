"""Samples: how images become squares, labels follow, and validation is kept apart."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tests.support.small_frames import COUNT, LENS, SIDE, image_of, small_sequence
from vrcaps.core.color import linear_from_srgb
from vrcaps.core.errors import InputError
from vrcaps.learn.augment import Augmentation, with_shading, with_tone
from vrcaps.learn.networks import Backbone
from vrcaps.learn.picture_border import Letterbox
from vrcaps.learn.samples import Samples, samples_of, split_samples
from vrcaps.learn.tasks.classification import ClassificationTask
from vrcaps.learn.tasks.depth import DepthTask
from vrcaps.learn.tasks.segmentation import SegmentationTask
from vrcaps.lumen.particles import FIRST_CLUMP


@pytest.mark.parametrize("shape", [(48, 48), (30, 90), (101, 57), (640, 480)])
def test_image_keeps_its_aspect_and_a_map_comes_back(shape):
    fit = Letterbox(*shape, 64)
    rows, columns = fit.region
    height, width = rows.stop - rows.start, columns.stop - columns.start
    assert max(height, width) == 64
    assert height / width == pytest.approx(shape[0] / shape[1], abs=1.0 / min(height, width))
    y, x = np.mgrid[: shape[0], : shape[1]]
    ramp = (x / shape[1] + 2.0 * y / shape[0]).astype(np.float32)
    square = fit.nearest(ramp, np.nan)
    assert np.isnan(square).sum() == 64 * 64 - height * width
    assert np.abs(fit.back(np.nan_to_num(square)) - ramp).mean() < 3.0 / min(height, width)


def test_depth_and_ray_are_of_one_pixel():
    sequence = small_sequence()
    sample = DepthTask(backbone=Backbone(32)).sample(sequence, 3)
    fit = Letterbox(SIDE, SIDE, 32)
    column, row = fit.pixels[10, 20]
    np.testing.assert_allclose(sample["ray"][10, 20], LENS.unproject([column, row]), atol=1e-6)
    assert sample["depth"][10, 20] == sequence.image("depth", 3)[row, column]


def test_rays_turn_with_their_pixels():
    plain = Augmentation(min_crop=1.0)
    learner = DepthTask(Backbone(SIDE // 32 * 32), exposure_dropout=0.0, augmentation=plain)
    sample = learner.sample(small_sequence(), 0)
    turned = [sample["depth"], sample["depth"].T]
    symmetries = [np.flip(one, axes) for one in turned for axes in ((), (0,), (1,), (0, 1))]
    found, unchanged = set(), 0
    for seed in range(60):
        changed = learner.augment(sample, np.random.default_rng(seed))
        np.testing.assert_allclose(changed["ray"], sample["ray"], atol=1e-6)  # a centered lens
        which = [k for k, one in enumerate(symmetries) if np.array_equal(changed["depth"], one)]
        assert which
        found.add(which[0])
        unchanged += changed["image"].sum() == sample["image"].sum()
    assert len(found) == 8
    assert unchanged == 60  # images of known exposure keep their colors
    dropping = replace(learner, exposure_dropout=1.0)
    sums = {dropping.augment(sample, np.random.default_rng(k))["image"].sum() for k in range(10)}
    assert len(sums) == 10


def test_labels_of_a_part_are_those_of_its_pixels():
    size = 64
    rows, columns = np.mgrid[:size, :size]
    image = np.stack([4 * columns, 4 * rows, 0 * rows], axis=-1).astype(np.uint8)
    sample = {"image": image, "place": np.stack([columns, rows], axis=-1), "class": np.asarray(1)}
    for seed in range(10):
        part = Augmentation(min_crop=0.5).crop(sample, np.random.default_rng(seed))
        assert part["image"].shape == image.shape
        assert part["class"] == 1
        inner = slice(2, -2)  # at the border color is that of its own side only
        shown = part["image"][inner, inner, :2] / 4.0
        assert np.abs(shown - part["place"][inner, inner]).max() <= 1.0
        width = np.ptp(part["place"][..., 0]) + 1
        assert 0.5 * size - 1 <= width <= size
    whole = Augmentation(min_crop=1.0).crop(sample, np.random.default_rng(0))
    assert whole["place"].tolist() == sample["place"].tolist()


def test_colors_stay_within_their_factors():
    gray = np.full((4, 4, 3), 100, np.uint8)
    jitter = Augmentation(exposure_jitter=1.2, color_jitter=1.1, gamma_jitter=1.0)
    shown = np.stack([jitter.recolor(gray, np.random.default_rng(k))[0, 0] for k in range(200)])
    assert shown.min() >= 100 / 1.32 - 1
    assert shown.max() <= 132 + 1
    assert np.ptp(shown, axis=1).max() > 5
    assert shown.mean() == pytest.approx(101, abs=3)


def test_a_tone_curve_lifts_dark_colors_and_keeps_black_and_white():
    gray = np.repeat(np.arange(256, dtype=np.uint8)[:, None, None], 3, axis=2)
    lifted = with_tone(gray, 4.0)
    assert lifted[0].max() == 0
    assert lifted[255].min() == 255
    assert (np.diff(lifted[:, 0, 0].astype(int)) >= 0).all()
    dark, before = linear_from_srgb(lifted)[8:20, 0, 0], linear_from_srgb(gray)[8:20, 0, 0]
    np.testing.assert_allclose(dark, 4.0 * before / (1.0 + 3.0 * before), rtol=0.03)
    np.testing.assert_array_equal(with_tone(gray, 1.0), gray)


def test_a_tone_jitter_of_one_leaves_the_other_changes():
    gray = np.full((4, 4, 3), 60, np.uint8)
    jitter, lifting = Augmentation(1.2, 1.1, 1.3), Augmentation(1.2, 1.1, 1.3, tone_jitter=8.0)
    plain, lifted = (
        np.stack([one.recolor(gray, np.random.default_rng(k))[0, 0] for k in range(50)]).astype(int)
        for one in (jitter, lifting)
    )
    assert (lifted >= plain - 1).all()
    assert lifted.mean() > 1.5 * plain.mean()


def test_shading_darkens_corners_by_its_ratio():
    gray = np.full((65, 65, 3), 188, np.uint8)
    light = linear_from_srgb(with_shading(gray, 4.0))[..., 0] / linear_from_srgb(gray)[0, 0, 0]
    assert light[32, 32] == 1.0
    assert light[0, 0] == pytest.approx(0.25, rel=0.03)
    assert light[32, 0] == pytest.approx(0.5, rel=0.02)
    np.testing.assert_array_equal(light, light.T)
    np.testing.assert_array_equal(with_shading(gray, 1.0), gray)
    shaded = Augmentation(1.0, 1.0, 1.0, shading_jitter=4.0)
    corners = [shaded.recolor(gray, np.random.default_rng(k))[0, 0, 0] for k in range(20)]
    assert 98 <= min(corners) < max(corners) - 40 <= 148


def test_masks_of_one_kind_of_lesion():
    lesions = [{"instance": 1, "kind": "polyp"}, {"instance": 2, "kind": "bleeding"}]
    numbers = np.zeros((SIDE, SIDE), np.uint16)
    numbers[:10], numbers[20:25], numbers[30:35] = 1, 2, FIRST_CLUMP
    recorded = replace(
        small_sequence(episode=SimpleNamespace(head={"organ": {"lesions": lesions}})),
        load=lambda channel, index: numbers if channel == "instance" else image_of(channel, index),
    )
    learner = SegmentationTask(backbone=Backbone(64), classes=("polyp", "bleeding", "lesion"))
    assert len(learner.items(recorded)) == COUNT
    masks = learner.sample(recorded, 0)["mask"]
    assert (masks[..., 0] | masks[..., 1]).tolist() == masks[..., 2].tolist()
    assert 0 < masks[..., 1].sum() < masks[..., 0].sum()
    with pytest.raises(InputError, match="'label'"):
        SegmentationTask(classes=("tumor",)).items(small_sequence())


def test_mask_turns_with_its_image():
    learner = SegmentationTask(
        backbone=Backbone(64), augmentation=Augmentation(exposure_jitter=1.0, color_jitter=1.0)
    )
    sample = learner.sample(small_sequence(), 1)
    for seed in range(6):
        changed = learner.augment(sample, np.random.default_rng(seed))
        red = changed["image"][..., 0] > 1.8 * changed["image"][..., 1].astype(int)
        assert (red == (changed["mask"][..., 0] == 1)).mean() > 0.96


def test_patients_are_not_in_both_parts():
    sequences = [small_sequence(k, f"s{k}", patient=str(k // 2)) for k in range(20)]
    train, held = split_samples(DepthTask(backbone=Backbone(32)), sequences)
    of = [{one.patient for one, _ in part.frames} for part in (train, held)]
    assert not of[0] & of[1]
    assert len(of[1]) == 2


def test_splits_of_the_data_are_kept_and_its_test_part_is_not_touched():
    splits = ("train", "val", "test")
    sequences = [small_sequence(k, split=split) for k, split in enumerate(splits)]
    train, held = split_samples(DepthTask(backbone=Backbone(32)), sequences)
    assert {one.split for one, _ in train.frames} == {"train"}
    assert {one.split for one, _ in held.frames} == {"val"}


def test_part_of_what_is_learned_from_is_held_out_where_no_validation_split_is():
    splits = ["train"] * 10 + ["test"] * 2
    sequences = [
        small_sequence(k, f"s{k}", patient=str(k), split=split) for k, split in enumerate(splits)
    ]
    train, held = split_samples(DepthTask(backbone=Backbone(32)), sequences)
    names = [{one.name for one, _ in part.frames} for part in (train, held)]
    assert len(names[0]) == 8
    assert len(names[1]) == 2
    assert not names[0] & names[1]
    assert not {"s10", "s11"} & (names[0] | names[1])


def test_shares_of_a_learning_curve_lie_within_one_another():
    samples = samples_of(DepthTask(backbone=Backbone(32)), [small_sequence()])
    small, large = (samples.subset(fraction, seed=1).frames for fraction in (0.25, 0.5))
    assert len(small) == COUNT // 4
    assert {k for _, k in small} < {k for _, k in large}


def test_damaged_image_is_skipped_counted_and_named():
    def load(channel, index):
        if index == 2:
            raise InputError("Cannot read 000002.png: truncated.")
        return small_sequence().load(channel, index)

    sequence = small_sequence()
    object.__setattr__(sequence, "load", load)
    samples = Samples(SegmentationTask(backbone=Backbone(32)), [(sequence, k) for k in range(4)])
    assert samples.get(2) is None
    assert np.array_equal(samples.next(2)["image"], samples.get(3)["image"])
    assert samples.skipped == {"small, frame 2": "Cannot read 000002.png: truncated."}


def test_what_cannot_be_learned_from_is_one_clear_line():
    sequence = small_sequence()
    bare = sequence.with_channels(("rgb",))
    with pytest.raises(InputError, match=r"requires the channel 'depth'\. small has none"):
        samples_of(DepthTask(), [bare])
    with pytest.raises(InputError, match=r"no recording for depth\. Choose another split"):
        samples_of(DepthTask(), [])
    with pytest.raises(InputError, match="images have no masks"):
        samples_of(SegmentationTask(), [bare])
    with pytest.raises(InputError, match="No frame of small can be used for classification"):
        samples_of(ClassificationTask(classes=("ulcer", "bleeding")), [sequence])
    with pytest.raises(InputError, match=r"size is 100\. Allowed: multiples of 32"):
        SegmentationTask(backbone=Backbone(100))
    with pytest.raises(InputError, match="classes is"):
        ClassificationTask(classes=("polyp",))
