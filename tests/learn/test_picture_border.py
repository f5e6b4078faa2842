"""Borders, inserts and lenses of images from elsewhere, and depth estimated of them."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from vrcaps.camera.camera import Camera
from vrcaps.camera.lens import LensPinhole
from vrcaps.capsule.device_file import read_device
from vrcaps.core.color import linear_from_srgb, srgb_from_linear
from vrcaps.core.errors import InputError
from vrcaps.learn.networks import Backbone
from vrcaps.learn.picture_border import (
    assumed_camera,
    bright_part,
    exposure_of,
    inserts,
    log_scale_of,
    view_of,
)
from vrcaps.learn.prediction import images_of
from vrcaps.recording.frame_files import write_images
from vrcaps.recording.frame_sequence import EXPOSURE, FrameSequence

TOP, LEFT, HEIGHT, WIDTH = 10, 24, 40, 60


def framed() -> np.ndarray:
    """A picture of 60 x 40 pixels in a black border, with a bluish box in its corner."""
    image = np.full((64, 96, 3), 3, np.uint8)
    part = image[TOP : TOP + HEIGHT, LEFT : LEFT + WIDTH]
    part[...] = (180, 90, 70)
    part[-14:, :16] = (30, 60, 160)
    return image


def sequence(image: np.ndarray, camera: Camera | None = None) -> FrameSequence:
    depth = np.full(image.shape[:2], 0.02, np.float32)
    stored = {"rgb": image, "depth": depth}
    values = {"time": np.zeros(1)}
    return FrameSequence("a", ("rgb", "depth"), values, lambda name, k: stored[name], camera)


def test_the_border_is_what_is_black_at_the_edges() -> None:
    assert bright_part(framed()) == (slice(10, 50), slice(24, 84))
    black = np.zeros((8, 9, 3), np.uint8)
    assert bright_part(black) == (slice(0, 8), slice(0, 9))
    full = np.full((8, 9, 3), 100, np.uint8)
    assert bright_part(full) == (slice(0, 8), slice(0, 9))


def test_depth_takes_the_image_at_the_exposure_of_the_camera() -> None:
    """Twice the exposure doubles the linear image; a bright wall is not clipped by the division."""
    torch = pytest.importorskip("torch", reason="PyTorch is not installed")
    from vrcaps.learn.samples import batch_of
    from vrcaps.learn.tasks.depth import DepthTask

    image = framed()
    one = sequence(image, Camera("a", LensPinhole(fx=50.0, fy=50.0, cx=47.5, cy=31.5), 96, 64))
    exposed = replace(one, values={**one.values, EXPOSURE: np.array([2.0])})
    assert view_of(exposed, 0, predicts_lengths=True).exposure == 2.0
    assert exposure_of(exposed, 0) == 2.0
    assert view_of(exposed, 0).exposure == exposure_of(one, 0) == 1.0

    torch.manual_seed(0)
    learner = DepthTask(Backbone(32))
    given: list[Any] = []

    def network(image: Any, ray: Any) -> Any:
        given.append(image)
        return image[:, :1]

    for exposure in (2.0, 0.1):
        values = {**one.values, EXPOSURE: np.array([exposure])}
        sample = learner.sample(replace(one, values=values), 0)
        learner.output(network, batch_of([sample]))  # type: ignore[arg-type]
        expected = linear_from_srgb(sample["image"]) / exposure
        encoded = np.where(
            expected <= 0.0031308, 12.92 * expected, 1.055 * expected ** (1.0 / 2.4) - 0.055
        )
        np.testing.assert_allclose(given[-1][0].permute(1, 2, 0), encoded, atol=1e-5)
    assert given[-1].max() > 1.5


def test_an_unknown_exposure_scales_distances() -> None:
    """Four times the light is taken for four times the exposure: twice the predicted distance."""
    image = framed()
    dark, plain = (srgb_from_linear(factor * linear_from_srgb(image)) for factor in (0.25, 1.0))
    scales = [view_of(sequence(one), 0, predicts_lengths=True).log_scale for one in (dark, plain)]
    assert scales[1] - scales[0] == pytest.approx(math.log(2.0), abs=0.02)
    median = np.median(linear_from_srgb(np.array([180, 90, 70], np.uint8)).mean())
    assert scales[1] == pytest.approx(0.5 * math.log(median / 0.06), abs=0.02)
    known = replace(sequence(image), values={"time": np.zeros(1), EXPOSURE: np.array([2.0])})
    assert view_of(known, 0, predicts_lengths=True).log_scale == 0.0
    unknown = replace(known, values={"time": np.zeros(1), EXPOSURE: np.array([np.nan])})
    assert view_of(unknown, 0, predicts_lengths=True).log_scale == scales[1]
    assert view_of(unknown, 0, predicts_lengths=True).exposure == 1.0
    assert view_of(sequence(image), 0).log_scale == 0.0  # tasks without lengths
    black = np.zeros_like(image)
    assert view_of(sequence(black), 0, predicts_lengths=True).log_scale == 0.0


def test_the_scale_of_an_unknown_exposure_reaches_prediction() -> None:
    torch = pytest.importorskip("torch", reason="PyTorch is not installed")
    from vrcaps.learn.samples import batch_of
    from vrcaps.learn.tasks.depth import DepthTask

    torch.manual_seed(0)
    learner = DepthTask(backbone=Backbone(32))
    network = learner.network(is_pretrained=False).eval()
    camera = Camera("a", LensPinhole(fx=50.0, fy=50.0, cx=47.5, cy=31.5), 96, 64)
    view = view_of(sequence(framed(), camera), 0, predicts_lengths=True)
    with torch.inference_mode():
        plain, scaled = (
            learner.output(network, batch_of([learner.view_inputs(one)]))
            for one in (replace(view, log_scale=0.0), replace(view, log_scale=0.5))
        )
    np.testing.assert_allclose(scaled, plain + 0.5, atol=1e-6)


def test_a_normalized_prediction_does_not_depend_on_an_unknown_exposure() -> None:
    """Images whose linear values differ by a factor have the same prediction, up to rounding."""
    torch = pytest.importorskip("torch", reason="PyTorch is not installed")
    from vrcaps.learn.samples import batch_of
    from vrcaps.learn.tasks.depth import DepthTask

    torch.manual_seed(0)
    learner = DepthTask(backbone=Backbone(32), normalizes_exposure=True)
    network = learner.network(is_pretrained=False).eval()
    camera = Camera("a", LensPinhole(fx=50.0, fy=50.0, cx=47.5, cy=31.5), 96, 64)
    image = np.random.default_rng(0).integers(120, 160, (64, 96, 3)).astype(np.uint8)
    linear = linear_from_srgb(image)
    shade = np.where(np.arange(96)[:, None] < 48, 1.0, 0.2)
    images = image, srgb_from_linear(2.0 * linear), srgb_from_linear(shade * linear)
    views = [view_of(sequence(one, camera), 0, predicts_lengths=True) for one in images]
    with torch.inference_mode():
        plain, twice, shaded, known = (
            learner.output(network, batch_of([learner.view_inputs(view)])).numpy()
            for view in (*views, replace(views[0], log_scale=0.0))
        )
    assert np.abs(twice - plain).max() < 0.1 * np.abs(shaded - plain).max()
    assert np.abs(known - plain).max() > 1e-3


def test_a_mirrored_image_has_the_mirrored_prediction() -> None:
    """With `mirroring` a prediction is equivariant; without it, an untrained network's is not."""
    torch = pytest.importorskip("torch", reason="PyTorch is not installed")
    from vrcaps.learn.augment import flip
    from vrcaps.learn.samples import batch_of
    from vrcaps.learn.tasks.depth import DepthTask

    torch.manual_seed(0)
    plain = DepthTask(backbone=Backbone(32))
    mean = replace(plain, mirroring=True)
    network = mean.network(is_pretrained=False).eval()
    camera = Camera("a", LensPinhole(fx=50.0, fy=50.0, cx=44.0, cy=35.0), 96, 64)
    given = plain.view_inputs(view_of(sequence(framed(), camera), 0, predicts_lengths=True))
    for axis, component in ((1, 0), (0, 1)):
        mirrored = flip(given, axis)
        mirrored["ray"][..., component] *= -1.0
        with torch.inference_mode():
            one, other = (mean.output(network, batch_of([g]))[0, 0] for g in (given, mirrored))
            network.mirroring = False
            alone = [plain.output(network, batch_of([g]))[0, 0] for g in (given, mirrored)]
            network.mirroring = True
        np.testing.assert_allclose(np.flip(other.numpy(), axis), one, atol=1e-5)
        assert np.abs(np.flip(alone[1].numpy(), axis) - alone[0].numpy()).max() > 1e-3


def test_training_drops_the_exposure_of_a_fraction_of_images() -> None:
    pytest.importorskip("torch", reason="PyTorch is not installed")
    from vrcaps.learn.augment import Augmentation
    from vrcaps.learn.tasks.depth import DepthTask

    none = Augmentation(1.0, 1.0, 1.0, 1.0)
    image = np.full((32, 32, 3), (180, 90, 70), np.uint8)
    maps = {"ray": np.ones((32, 32, 3)), "depth": np.ones((32, 32))}
    sample = {"image": image, **maps, "log_scale": np.zeros((), np.float32)}
    for dropout, expected in ((0.0, 0), (1.0, 40), (0.25, 10)):
        learner = DepthTask(Backbone(32), exposure_dropout=dropout, augmentation=none)
        changed = [
            (learner.augment(sample, np.random.default_rng(k))["image"] != image).any()
            for k in range(40)
        ]
        assert abs(sum(changed) - expected) <= 6 * (0.0 < dropout < 1.0)


def test_masks_turn_with_their_image() -> None:
    """With `mirroring` a mask is equivariant; without it, an untrained network's is not."""
    torch = pytest.importorskip("torch", reason="PyTorch is not installed")
    from vrcaps.learn.tasks.segmentation import SegmentationTask

    torch.manual_seed(0)
    network = SegmentationTask(backbone=Backbone(64), mirroring=True).network(is_pretrained=False)
    image = torch.rand(2, 3, 64, 64)
    for is_mirroring, is_equivariant in ((True, True), (False, False)):
        network.eval().mirroring = is_mirroring
        with torch.inference_mode():
            mask = network(image)
            turned = network(image.transpose(2, 3).flip(3)).flip(3).transpose(2, 3)
        assert is_equivariant == torch.allclose(mask, turned, atol=1e-4)
        assert (mask[0] - mask[1]).abs().max() > 1e-3
    network.train().mirroring = True
    assert network(image).shape == (2, 1, 64, 64)


def test_unknown_exposures_change_up_to_their_maximum() -> None:
    pytest.importorskip("torch", reason="PyTorch is not installed")
    from vrcaps.learn.augment import Augmentation
    from vrcaps.learn.tasks.depth import DepthTask

    none = Augmentation(1.0, 1.0, 1.0, 1.0)
    image = np.full((32, 32, 3), 64, np.uint8)
    maps = {"ray": np.ones((32, 32, 3)), "depth": np.ones((32, 32))}
    light = linear_from_srgb(image).mean()
    for limit in (1.0, 2.0, 8.0):
        learner = DepthTask(
            Backbone(32), exposure_dropout=1.0, max_exposure=limit, augmentation=none
        )
        samples = (
            learner.augment({"image": image, **maps}, np.random.default_rng(k)) for k in range(60)
        )
        ratios = [linear_from_srgb(one["image"]).mean() / light for one in samples]
        assert max(ratios) == pytest.approx(limit, rel=0.15)
        assert min(ratios) == pytest.approx(1.0 / limit, rel=0.15)


def test_training_changes_colors_of_images_of_unknown_exposure_alone() -> None:
    pytest.importorskip("torch", reason="PyTorch is not installed")
    from vrcaps.learn.augment import Augmentation
    from vrcaps.learn.tasks.depth import DepthTask

    colors = Augmentation(1.0, 1.5, 1.5, 1.0)
    learner = DepthTask(Backbone(32), exposure_dropout=0.0, augmentation=colors)
    image = np.full((32, 32, 3), (180, 90, 70), np.uint8)
    known = {"image": image, "ray": np.ones((32, 32, 3)), "depth": np.ones((32, 32))}
    known |= {"log_scale": np.zeros((), np.float32), "exposure": np.array(0.5, np.float32)}
    unknown = known | {"log_scale": np.array(0.3, np.float32)}
    kept, changed = (
        learner.augment(dict(one), np.random.default_rng(3)) for one in (known, unknown)
    )
    np.testing.assert_array_equal(kept["image"], image)
    assert (changed["image"] != image).any()
    assert changed["log_scale"] == pytest.approx(log_scale_of(changed["image"]))
    assert (float(kept["exposure"]), float(changed["exposure"])) == (0.5, 1.0)


def test_an_insert_is_a_box_of_foreign_color_with_a_margin() -> None:
    part = framed()[bright_part(framed())]
    found = inserts(part)
    assert found[-14:, :16].all()
    assert not found[: -14 - 3].any() and not found[:, 16 + 3 :].any()


def test_the_lens_follows_the_part_that_is_left() -> None:
    """A ray through a pixel of the part is the ray through that pixel of the image."""
    lens = LensPinhole(fx=50.0, fy=50.0, cx=47.5, cy=31.5)
    view = view_of(sequence(framed(), Camera("a", lens, 96, 64)), 0, predicts_lengths=True)
    assert view.camera is not None
    assert (view.camera.width, view.camera.height) == (WIDTH, HEIGHT)
    pixel = np.array([[5.0, 7.0]])
    ray = lens.unproject(pixel + np.array([LEFT, TOP]))
    np.testing.assert_allclose(view.camera.lens.unproject(pixel), ray, rtol=1e-12)
    whole = view.whole(np.ones((HEIGHT, WIDTH)))
    assert whole.shape == (64, 96)
    assert whole.sum() == (~view.is_insert).sum()


def test_tissue_in_blue_light_is_no_insert() -> None:
    blue = np.full((64, 96, 3), (40, 90, 80), np.uint8)
    assert not view_of(sequence(blue), 0, predicts_lengths=True).is_insert.any()


def test_tasks_without_lengths_see_the_whole_image() -> None:
    view = view_of(sequence(framed()), 0)
    assert view.image.shape == (64, 96, 3) and not view.is_insert.any()


def test_an_assumed_lens_sees_the_stated_angle_across_the_picture() -> None:
    camera = assumed_camera(60, 40, math.radians(120.0))
    edges = camera.lens.unproject(np.array([[-0.5, 19.5], [59.5, 19.5], [29.5, 19.5]]))
    angle = math.degrees(math.acos(edges[0] @ edges[1]))
    assert angle == pytest.approx(120.0)
    np.testing.assert_allclose(edges[2], (0.0, 0.0, 1.0), atol=1e-12)
    with pytest.raises(InputError, match=r"--fov is 360 degrees\. Allowed: above 0 to below 360"):
        assumed_camera(60, 40, math.radians(360.0))


def test_a_lens_is_asked_for_before_a_network_is_loaded(tmp_path) -> None:
    write_images([(tmp_path / "one.png", framed())])
    folder = str(tmp_path)
    for task in ("depth", "sfm"):
        with pytest.raises(InputError, match=r"Give --capsule NAME .* or --fov DEGREES"):
            images_of(folder, task)
    assert images_of(folder, "segmentation")[0].camera is None
    assert images_of(folder, "depth", field_of_view=2.0)[0].camera is None
    with pytest.raises(InputError, match=r"has 96 x 64 pixels, but the camera 'front' makes 320 x"):
        images_of(folder, "depth", "mirocam")
    with pytest.raises(InputError, match=r"--capsule and --fov are both given"):
        images_of(folder, "depth", "mirocam", 2.0)
    with pytest.raises(InputError, match=r"--fov is -1"):
        images_of(folder, "depth", field_of_view=math.radians(-1.0))


@pytest.mark.parametrize("damaged", ["a.png", "c.png"])
def test_an_unreadable_image_stops_no_other_in_either_order(tmp_path, damaged: str) -> None:
    write_images([(tmp_path / "b.png", framed())])
    (tmp_path / damaged).write_bytes(b"")
    (found,) = images_of(str(tmp_path), "depth", field_of_view=2.0)
    assert len(found) == 2
    with pytest.raises(InputError, match=r"has 96 x 64 pixels, but the camera 'front' makes 320 x"):
        images_of(str(tmp_path), "depth", "mirocam")
    (tmp_path / "b.png").write_bytes(b"")
    assert len(images_of(str(tmp_path), "depth", field_of_view=2.0)[0]) == 2


def test_the_colonoscope_is_a_camera_for_images_of_its_size(tmp_path) -> None:
    write_images([(tmp_path / "one.png", np.full((288, 320, 3), 90, np.uint8))])
    (one,) = images_of(str(tmp_path), "depth", "colonoscope")
    assert one.camera == read_device("colonoscope").cameras[0]


@pytest.mark.slow
def test_predict_estimates_what_evaluate_scores(tmp_path) -> None:
    """The estimate that is written is that of the sample that is scored, to the step of 10 µm."""
    torch = pytest.importorskip("torch", reason="PyTorch is not installed")
    from vrcaps.learn.checkpoint import TrainedNetwork
    from vrcaps.learn.evaluation import evaluate
    from vrcaps.learn.prediction import predict
    from vrcaps.learn.samples import samples_of
    from vrcaps.learn.tasks.depth import DepthTask, depth_of
    from vrcaps.recording.frame_files import read_image

    torch.manual_seed(0)
    learner = DepthTask(backbone=Backbone(32))
    trained = TrainedNetwork(learner, learner.network(is_pretrained=False).eval(), {})
    camera = Camera("a", LensPinhole(fx=50.0, fy=50.0, cx=47.5, cy=31.5), 96, 64)
    one = sequence(framed(), camera)
    found = evaluate(trained, samples_of(learner, [one]))
    predict(trained, (one,), tmp_path / "out")
    written = read_image(tmp_path / "out" / "a" / "000000.png").astype(float) * 1e-5
    view = view_of(one, 0, predicts_lengths=True)
    from vrcaps.learn.picture_border import Letterbox

    expected = view.whole(Letterbox(HEIGHT, WIDTH, 32).back(depth_of(found.outputs[0])))
    np.testing.assert_allclose(written, expected, atol=0.51e-5)
    assert (written[:TOP] == 0.0).all() and (written[TOP + 2, LEFT + 2 : -14] > 0.0).any()
    blank = replace(one, camera=None)
    predict(trained, (blank,), tmp_path / "assumed", field_of_view=2.0)
    assert (read_image(tmp_path / "assumed" / "a" / "000000.png") > 0).any()
