"""Degradations of training images for super-resolution."""

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed")

from tests.support.small_frames import small_sequence  # noqa: E402
from vrcaps.core.errors import InputError  # noqa: E402
from vrcaps.learn.perturbation import Degradation, demosaiced  # noqa: E402
from vrcaps.learn.tasks.super_resolution import SuperResolutionTask  # noqa: E402

STRONG = Degradation(max_blur=1.0, mosaic=True, max_noise=10.0, min_jpeg=40)


def test_one_color_survives_a_mosaic_and_detail_does_not() -> None:
    flat = np.broadcast_to([200.0, 100.0, 50.0], (8, 10, 3))
    np.testing.assert_allclose(demosaiced(flat), flat)
    ramp = np.repeat(np.arange(10.0)[None, :, None], 8, axis=0) * np.ones(3)
    np.testing.assert_allclose(demosaiced(ramp)[1:-1, 1:-1], ramp[1:-1, 1:-1])
    _, column = np.indices((8, 8))
    lines = np.where((column % 2 == 0)[..., None], 200.0, 0.0) * np.ones(3)
    found = demosaiced(lines)
    assert np.ptp(found[..., 0]) == 0.0  # red is known in every second column only


def test_each_degradation_alone_changes_some_images_and_keeps_others() -> None:
    image = small_sequence().image("rgb", 0)
    for one in (
        Degradation(max_blur=2.0),
        Degradation(mosaic=True),
        Degradation(max_noise=20.0),
        Degradation(min_jpeg=20),
    ):
        changed = [(one.apply(image, np.random.default_rng(k)) != image).any() for k in range(40)]
        assert 8 < sum(changed) < 32
    assert (Degradation().apply(image, np.random.default_rng(0)) == image).all()


def test_the_same_draw_gives_the_same_image() -> None:
    image = small_sequence().image("rgb", 1)
    first, again = (STRONG.apply(image, np.random.default_rng(4)) for _ in range(2))
    assert (first == again).all() and first.dtype == np.uint8 and first.shape == image.shape


def test_training_degrades_the_small_image_and_not_the_truth() -> None:
    learner = SuperResolutionTask(2, size=32, blocks=1, features=8, degradation=STRONG)
    clean = SuperResolutionTask(2, size=32, blocks=1, features=8)
    sample = learner.sample(small_sequence(), 1)
    assert (sample["image"] == clean.sample(small_sequence(), 1)["image"]).all()
    pairs = [one.augment(sample, np.random.default_rng(3)) for one in (learner, clean)]
    assert (pairs[0]["truth"] == pairs[1]["truth"]).all()
    assert any(
        (
            learner.augment(sample, np.random.default_rng(k))["image"]
            != clean.augment(sample, np.random.default_rng(k))["image"]
        ).any()
        for k in range(4)
    )


def test_bad_strengths_are_refused() -> None:
    with pytest.raises(InputError, match=r"min_jpeg is 120\. Allowed: 0 to 95"):
        Degradation(min_jpeg=120)
    with pytest.raises(InputError, match=r"max_noise is -1"):
        Degradation(max_noise=-1.0)
