"""Masked parts of images, so that corners, inserts and text do not reveal the class."""

from dataclasses import replace
from types import SimpleNamespace
from typing import get_args

import numpy as np
import pytest

from tests.support.small_frames import SIDE, small_sequence
from vrcaps.core.errors import InputError
from vrcaps.learn.networks import Backbone
from vrcaps.learn.picture_border import Letterbox, Overlay, tissue_mask
from vrcaps.learn.tasks.classification import ClassificationTask

LEARNER = ClassificationTask(("normal", "polyp"), backbone=Backbone(64))


@pytest.mark.parametrize(("height", "width"), [(64, 64), (50, 80)])
def test_corners_and_insert_are_hidden_whatever_is_there(height, width):
    plain = np.full((height, width, 3), 180, np.uint8)
    marked = plain.copy()
    marked[: height // 8, : width // 8] = 0
    marked[-height // 3 :, : int(0.4 * width)] = [0, 160, 140]
    fit = Letterbox(height, width, 64)
    images = [LEARNER.inputs(one, fit, None)["image"] for one in (plain, marked)]
    np.testing.assert_array_equal(*images)
    assert (images[0] > 0).any(axis=-1).mean() > 0.3
    shown = replace(LEARNER, mask_overlays=()).inputs(marked, fit, None)["image"]
    np.testing.assert_array_equal(shown, fit.image(marked))


def test_each_kind_hides_its_part():
    everything = tissue_mask(100, 100, ())
    assert everything.all()
    corners, insert, text = (tissue_mask(100, 100, (kind,)) for kind in get_args(Overlay))
    assert not corners[0, 0] and not corners[99, 99] and corners[50, 50] and corners[50, 10]
    assert not insert[99, 0] and insert[0, 0] and insert[99, 99]
    assert not text[50, 10] and text[50, 40]
    both = tissue_mask(100, 100, ("corners", "insert"))
    np.testing.assert_array_equal(both, corners & insert)


def test_a_recorded_lesion_counts_where_it_is_seen():
    """A lesion in a hidden corner does not make the frame its own; one in the middle does."""
    lesions = [{"instance": 1, "kind": "polyp"}]

    def load(channel, index):
        image = np.zeros((SIDE, SIDE), np.uint16)
        corner, middle = slice(0, 5), slice(20, 28)
        image[(corner, corner) if index % 2 else (middle, middle)] = 1
        return image

    sequence = small_sequence()
    episode = SimpleNamespace(head={"organ": {"lesions": lesions}})
    values = {"time": sequence.times}
    sequence = replace(sequence, values=values, load=load, episode=episode)
    named = LEARNER.prepare(sequence)
    assert list(named.values["class"][:2]) == ["polyp", "normal"]
    assert LEARNER.prepare(named) is named
    assert list(replace(LEARNER, mask_overlays=()).items(sequence)) == list(range(len(sequence)))


def test_each_class_must_have_frames():
    frames = [(small_sequence(), k) for k in (1, 3, 5)]
    with pytest.raises(
        InputError, match=r"No training frame has the class 'normal'\. Frames: 3 polyp\. Give"
    ):
        LEARNER.require(frames)
    LEARNER.require([*frames, (small_sequence(), 0)])
    bare = replace(small_sequence(), values={"time": np.arange(20.0)})
    with pytest.raises(InputError, match=r"small has no classes\. Give a folder with a subfolder"):
        LEARNER.items(bare)
