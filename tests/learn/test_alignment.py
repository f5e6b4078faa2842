"""Motion by direct alignment, in both directions, and labels of augmented video."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed")
pytest.importorskip("segmentation_models_pytorch", reason="its package is not installed")

from tests.support.ellipsoid_sequence import ellipsoid_sequence  # noqa: E402
from vrcaps.camera.lens import LensEquidistant, LensPinhole  # noqa: E402
from vrcaps.learn.losses import pose_matrix  # noqa: E402
from vrcaps.learn.motion_solver import Flow, motion_from_flow, mutual_motion  # noqa: E402
from vrcaps.learn.motion_steps import (  # noqa: E402
    aligned,
    common_region,
    motion_of,
    relative_brightness,
)
from vrcaps.learn.motion_training import cropped, flow_error, mirrored, motion_error, transposed  # noqa: E402  # noqa: E402
from vrcaps.learn.networks import Backbone  # noqa: E402
from vrcaps.learn.samples import batch_of  # noqa: E402
from vrcaps.learn.tasks.depth import MIDDLE  # noqa: E402
from vrcaps.learn.tasks.sfm import SfmTask  # noqa: E402

SIDE = 64
FISHEYE = LensEquidistant(focal=22.0, cx=31.5, cy=31.5, max_angle=1.4)
PINHOLE = LensPinhole(fx=44.0, fy=46.0, cx=30.4, cy=31.8)
TASK = SfmTask(
    backbone=Backbone(SIDE),
    supervision=1.0,
    photometric_weight=0.0,
    geometry_weight=0.0,
    smoothness_weight=0.0,
)


def sample(lens=FISHEYE) -> dict:
    """A frame with its neighbors and labels."""
    return dict(TASK.sample(ellipsoid_sequence(lens, SIDE, SIDE), 2))


def true_log_distance(batch):
    """ln of the true distances in units of 30 mm."""
    distance = batch["depth"] / batch["ray"][:, 2].clamp(min=0.05)
    return torch.log(distance.nan_to_num(MIDDLE) / MIDDLE)[:, None]


@pytest.mark.parametrize(
    ("lens", "limit"), [(FISHEYE, 0.1), (PINHOLE, 0.3)], ids=["fisheye", "pinhole"]
)
def test_alignment_finds_the_motion_from_images_and_distances(lens, limit) -> None:
    """Relative to the true motion; that of no motion is 1."""
    batch = batch_of([sample(lens)])
    T = batch["T_before_own"]
    motion = aligned(batch["image"], batch["before"], batch["ray"], true_log_distance(batch))
    shift = MIDDLE * motion[0, 3:]
    assert float((shift - T[0, :3, 3]).norm() / T[0, :3, 3].norm()) < limit
    turned = (pose_matrix(motion)[0, :3, :3] - T[0, :3, :3]).norm()
    assert float(turned) < limit * float((torch.eye(3) - T[0, :3, :3]).norm())


def test_alignment_ignores_exposure_and_equal_frames_do_not_move() -> None:
    batch = batch_of([sample()])
    log_distance = true_log_distance(batch)
    given = batch["image"], batch["ray"], log_distance
    motions = [aligned(given[0], gain * batch["before"], *given[1:]) for gain in (1.0, 0.6)]
    assert float((motions[0] - motions[1]).norm() / motions[0].norm()) < 0.05
    assert float(aligned(given[0], given[0], *given[1:]).norm()) < 1e-3


def test_alignment_keeps_the_better_of_its_starts() -> None:
    """From a wild start alone the motion is not found; next to none it does no harm."""
    batch = batch_of([sample()])
    given = batch["image"], batch["before"], batch["ray"], true_log_distance(batch)
    wild = torch.tensor([[0.6, -0.5, 0.4, 0.5, 0.4, -0.3]])
    torch.testing.assert_close(aligned(*given, (wild,)), aligned(*given), atol=1e-4, rtol=1e-3)


def test_relative_brightness_has_unit_spread_and_no_mean() -> None:
    gray = torch.rand(1, 1, 40, 40, generator=torch.Generator().manual_seed(0))
    inside = relative_brightness(gray, torch.ones_like(gray))[..., 8:-8, 8:-8]
    assert abs(float(inside.mean())) < 0.05 and 0.7 < float(inside.std()) < 1.1


def test_motions_in_both_directions_have_the_mean_of_one_and_the_inverse_of_the_other() -> None:
    motion = torch.tensor([[0.02, -0.03, 0.05, 0.1, -0.2, 0.3]], dtype=torch.float64)
    T = pose_matrix(motion)[0]
    torch.testing.assert_close(mutual_motion(T, torch.linalg.inv(T)), T)
    torch.testing.assert_close(motion_of(T[None]), motion)
    still = mutual_motion(T, T)[:3, :3]  # forth and back again is no rotation
    torch.testing.assert_close(still, torch.eye(3, dtype=torch.float64), atol=1e-9, rtol=0.0)


@pytest.mark.parametrize("aligns", [True, False])
def test_a_reversed_trajectory_is_the_inverse_and_a_still_one_stays(aligns) -> None:
    learner = SfmTask(backbone=Backbone(32), aligns=aligns)
    torch.manual_seed(0)
    network = learner.network(is_pretrained=False).eval()
    sequence = ellipsoid_sequence(LensEquidistant(13.0, 15.5, 15.5, 1.4), 32, 32, frames=3)
    there = learner.trajectory(network, sequence).Ts_world_camera
    back = learner.trajectory(network, sequence.subset([2, 1, 0])).Ts_world_camera
    np.testing.assert_allclose(back[2] @ there[2], np.eye(4), atol=5e-4)
    still = learner.trajectory(network, sequence.subset([1, 1])).Ts_world_camera
    np.testing.assert_allclose(still[1], np.eye(4), atol=1e-6)
    assert np.abs(there[2] - np.eye(4)).max() > 5e-3


@pytest.mark.parametrize("change", ["mirrored", "flipped", "transposed", "cropped"])
def test_labels_of_augmented_video_agree(change) -> None:
    """The motion that follows from the changed flow and rays is the changed motion."""
    original = sample()
    changes = {
        "mirrored": lambda one: mirrored(one, 1),
        "flipped": lambda one: mirrored(one, 0),
        "transposed": transposed,
        "cropped": lambda one: cropped(one, 0.6, np.random.default_rng(0)),
    }
    batch = batch_of([changes[change](original)])
    flow = batch["flow_after"]
    known = torch.isfinite(flow).all(dim=1, keepdim=True)
    found = Flow(flow.nan_to_num(0.0), known.float())
    motion = motion_from_flow(found, batch["ray"], true_log_distance(batch))
    T = batch["T_after_own"]
    error = MIDDLE * motion[0, 3:] - T[0, :3, 3]
    assert float(error.norm() / T[0, :3, 3].norm()) < 0.05
    assert (change == "cropped") == np.array_equal(T[0].numpy(), original["T_after_own"])
    assert not np.array_equal(batch["image"][0].numpy(), batch_of([original])["image"][0].numpy())


def test_losses_are_least_at_the_truth() -> None:
    batch = batch_of([sample()])
    truth = batch["flow_before"]
    weight = torch.full_like(truth[:, :1], 4.0)

    def error(shift: float, factor: float = 1.0) -> float:
        return float(flow_error(Flow(truth.nan_to_num(0.0) + shift, factor * weight), truth))

    assert error(0.0) < error(0.5) < error(2.0)
    assert error(2.0, 0.01) < error(2.0)  # a wrong flow costs less if it is stated as uncertain
    T = batch["T_before_own"]
    right = pose_matrix(motion_of(T))
    right[:, :3, 3] /= MIDDLE
    static = torch.eye(4)[None]
    assert float(motion_error(right, T)) < 0.01
    assert float(motion_error(static, T)) > 0.5


def test_border_of_a_video_is_left_out() -> None:
    sequence = ellipsoid_sequence(FISHEYE, SIDE, SIDE)

    def load(channel: str, index: int) -> np.ndarray:
        image = np.full((SIDE, SIDE, 3), 120, np.uint8)
        image[:9], image[:, 50 + index :] = 0, 0
        return image

    region = common_region(replace(sequence, load=load), np.arange(5))
    assert region == (slice(9, SIDE), slice(0, 54))
