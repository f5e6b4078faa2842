"""Views of equal angle from images with and without a border; draws limited by patient."""

from __future__ import annotations

import numpy as np
import pytest

from vrcaps.core.errors import InputError
from vrcaps.recording.frame_sequence import FrameSequence
from vrcaps.tools.appearance.views import SIDE, central_view, read_image_set


def smooth_image(side: int) -> np.ndarray:
    y, x = (np.mgrid[:side, :side] + 0.5) / side
    return np.stack([60 + 150 * x, 60 + 150 * y, 120 + 40 * np.sin(6 * x)], -1).astype(np.uint8)


@pytest.mark.parametrize("side", [224, 320, 500])
def test_views_show_the_same_part_at_any_size(side: int):
    reference = central_view(smooth_image(448)).astype(int)
    view = central_view(smooth_image(side)).astype(int)
    assert view.shape == (SIDE, SIDE, 3)
    assert np.abs(view - reference).mean() < 1.5


def test_a_border_and_text_on_it_are_left_out():
    image = smooth_image(300)
    bordered = np.zeros((400, 500, 3), np.uint8)
    bordered[40:340, 120:420] = image
    bordered[5:12, 10:40] = 255
    difference = central_view(bordered).astype(int) - central_view(image)
    assert np.abs(difference).max() <= 1


def test_a_black_image_has_a_view():
    assert not central_view(np.zeros((50, 60, 3), np.uint8)).any()


def sequence(name: str, patient: str | None, frames: int) -> FrameSequence:
    def load(channel: str, index: int) -> np.ndarray:
        return np.full((32, 32, 3), 100 + index, np.uint8)

    return FrameSequence(name, ("rgb",), {"time": np.arange(float(frames))}, load, patient=patient)


def test_no_patient_has_more_than_22_images():
    sets = [sequence("a", "first", 40), sequence("b", "first", 40), sequence("c", "second", 5)]
    images = read_image_set("ours", sets, max_images=100)
    assert (images.groups == "first").sum() == 22
    assert (images.groups == "second").sum() == 5
    assert len(images) == len(images.views) == len(images.names) == 27


def test_at_most_so_many_images_are_drawn_and_the_seed_decides_which():
    sets = [sequence("a", None, 90)]
    first, again, other = (
        read_image_set("ours", sets, max_images=10, seed=seed).names for seed in (0, 0, 1)
    )
    assert len(first) == 10
    assert first == again != other


def test_too_few_images_are_refused():
    with pytest.raises(InputError, match=r"mine has 2 images\. Allowed: 3 or more"):
        read_image_set("mine", [sequence("a", None, 2)], max_images=10)
    with pytest.raises(InputError, match=r"max_images is 2\. Allowed: 3 or more"):
        read_image_set("mine", [sequence("a", None, 9)], max_images=2)
