"""Frames predicted from neighbors: against OpenCV, and on a scene in closed form."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

torch = pytest.importorskip("torch", reason="PyTorch is not installed")

from tests.support.ellipsoid_sequence import ellipsoid_sequence  # noqa: E402
from tests.support.small_frames import small_sequence  # noqa: E402
from vrcaps.camera.camera import Camera, pixel_grid  # noqa: E402
from vrcaps.camera.lens import LensEquidistant, LensKannalaBrandt, LensPinhole  # noqa: E402
from vrcaps.core.errors import InputError  # noqa: E402
from vrcaps.learn.checkpoint import read_weights  # noqa: E402
from vrcaps.learn.losses import (  # noqa: E402
    inconsistency,
    match_brightness,
    photometric_error,
    pose_matrix,
    smoothness,
    synthesize_view,
)
from vrcaps.learn.motion_solver import Flow, motion_from_flow, mutual_motion  # noqa: E402
from vrcaps.learn.motion_training import true_flow  # noqa: E402
from vrcaps.learn.networks import Backbone  # noqa: E402
from vrcaps.learn.picture_border import Letterbox  # noqa: E402
from vrcaps.learn.samples import Samples, batch_of  # noqa: E402
from vrcaps.learn.settings import TrainSettings  # noqa: E402
from vrcaps.learn.tasks.depth import MIDDLE  # noqa: E402
from vrcaps.learn.tasks.sfm import SfmTask  # noqa: E402
from vrcaps.learn.training import BEST, train  # noqa: E402
from vrcaps.training import ComputeSettings  # noqa: E402

SIDE, RADIUS = 32, 0.03
PINHOLE = LensPinhole(fx=22.0, fy=23.0, cx=15.2, cy=15.9, k1=-0.05, k2=0.01, p1=1e-3, p2=-2e-3)
FISHEYE = LensKannalaBrandt(fx=14.0, fy=14.5, cx=15.2, cy=15.9, k1=-0.05, k2=0.002)
EQUIDISTANT = LensEquidistant(focal=13.0, cx=15.5, cy=15.5, max_angle=1.4)
EQUIDISTANT_128 = LensEquidistant(focal=45.0, cx=63.5, cy=63.5, max_angle=1.4)
MOTION = torch.tensor([[0.02, -0.03, 0.05, 0.001, -0.002, 0.003]], dtype=torch.float64)

PLACE = np.eye(4)
PLACE[:3, 3] = [0.004, -0.006, -0.008]


def _rays(lens):
    rays = np.nan_to_num(lens.unproject(pixel_grid(SIDE, SIDE)))
    return torch.from_numpy(np.moveaxis(rays, -1, 0)[None].copy())


def _views(lens):
    return [(Letterbox(SIDE, SIDE, SIDE), Camera("front", lens, SIDE, SIDE))]


def _sphere(lens, T_world_camera):
    """Distance of a sphere's wall, and a smooth color of its place."""
    rays = np.nan_to_num(lens.unproject(pixel_grid(SIDE, SIDE)))
    world, origin = rays @ T_world_camera[:3, :3].T, T_world_camera[:3, 3]
    along = world @ origin
    reach = -along + np.sqrt(along**2 - origin @ origin + RADIUS**2)
    place = origin + reach[..., None] * world
    color = 0.5 + 0.4 * np.sin(place / RADIUS * 3.0 + [0.0, 1.0, 2.0])
    output = np.log(reach)
    return (
        torch.from_numpy(np.moveaxis(color, -1, 0)[None].copy()),
        torch.from_numpy(output[None, None].copy()),
    )


@pytest.mark.parametrize("lens", [PINHOLE, FISHEYE], ids=["pinhole", "fisheye"])
def test_prediction_is_that_of_opencv(lens):
    cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed")
    rng = np.random.default_rng(0)
    neighbor = rng.random((SIDE, SIDE, 3)).astype(np.float32)
    reach = rng.uniform(0.02, 0.04, (SIDE, SIDE))
    ray = _rays(lens)
    points = (np.moveaxis(ray[0].numpy(), 0, -1) * reach[..., None]).reshape(-1, 1, 3)
    rotation, shift = MOTION[0, :3].numpy(), MOTION[0, 3:].numpy()
    matrix = np.array([[lens.fx, 0, lens.cx], [0, lens.fy, lens.cy], [0, 0, 1]])
    if lens is PINHOLE:
        coefficients = np.array([lens.k1, lens.k2, lens.p1, lens.p2, 0.0])
        pixels, _ = cv2.projectPoints(points, rotation, shift, matrix, coefficients)
    else:
        coefficients = np.array([lens.k1, lens.k2, 0.0, 0.0])
        pixels, _ = cv2.fisheye.projectPoints(points, rotation, shift, matrix, coefficients)
    grid = pixels.reshape(SIDE, SIDE, 2).astype(np.float32)
    oracle = cv2.remap(neighbor, grid, None, cv2.INTER_LINEAR)
    view = synthesize_view(
        torch.from_numpy(np.moveaxis(neighbor, -1, 0)[None].copy()).double(),
        torch.zeros(1, 1, SIDE, SIDE, dtype=torch.float64),
        torch.from_numpy(np.log(reach)[None, None]),
        pose_matrix(MOTION),
        ray,
        _views(lens),
    )
    inner = (grid > 0).all(-1) & (grid < SIDE - 1).all(-1) & view.is_valid[0].numpy()
    inner &= ray[0, 2].numpy() > 0.1  # OpenCV's fisheye sees nothing beside or behind
    difference = np.abs(np.moveaxis(view.color[0].numpy(), 0, -1) - oracle)[inner]
    assert inner.mean() > 0.7
    assert difference.max() < 0.04  # OpenCV rounds places to 1/32 px
    assert difference.mean() < 0.01


def test_motion_is_that_of_scipy():
    matrix = pose_matrix(MOTION)[0].numpy()
    oracle = Rotation.from_rotvec(MOTION[0, :3].numpy()).as_matrix()
    np.testing.assert_allclose(matrix[:3, :3], oracle, atol=1e-12)
    np.testing.assert_allclose(matrix[:3, 3], MOTION[0, 3:])


@pytest.mark.parametrize("lens", [PINHOLE, FISHEYE, EQUIDISTANT], ids=lambda one: one.kind)
def test_true_distances_and_motion_predict_the_frame(lens):
    image, own = _sphere(lens, PLACE)
    neighbor, other = _sphere(lens, PLACE @ np.linalg.inv(pose_matrix(MOTION)[0].numpy()))
    ray, views = _rays(lens), _views(lens)

    def losses(motion, output):
        view = synthesize_view(neighbor, other, output, pose_matrix(motion), ray, views)
        valid = view.is_valid
        error = photometric_error(view.color, image)[valid].mean()
        return float(error), float(inconsistency(view)[valid].mean()), float(valid.sum())

    true = losses(MOTION, own)
    assert true[0] < 0.01
    assert true[1] < 0.001
    assert true[2] > 0.5 * SIDE**2
    for wrong in (losses(0.0 * MOTION, own), losses(MOTION, own + 0.4), losses(-MOTION, own)):
        assert wrong[0] > 1.2 * true[0]
        assert wrong[1] > 20.0 * true[1]


@pytest.mark.slow
def test_learner_trains_and_writes_a_trajectory(tmp_path):
    pytest.importorskip("segmentation_models_pytorch", reason="its package is not installed")
    learner, sequence = SfmTask(backbone=Backbone(32)), small_sequence()
    samples = Samples(learner, [(sequence, k) for k in (1, 2)])
    settings = TrainSettings(learner, start="scratch", steps=2, batch=2, evaluate_every=2)
    (row,) = train(
        settings, samples, samples, tmp_path / "run", compute=ComputeSettings("cpu")
    ).rows
    assert np.isfinite(row["loss"])
    trained = read_weights(tmp_path / "run" / BEST, task="sfm")
    poses = replace(learner, aligns=False).trajectory(trained.network, sequence).Ts_world_camera
    assert poses.shape == (len(sequence), 4, 4)
    np.testing.assert_allclose(np.linalg.det(poses[:, :3, :3]), 1.0, atol=1e-5)
    step = np.linalg.inv(poses[4]) @ poses[5]
    letterbox = Letterbox(48, 48, 32)
    here, before = (
        batch_of([learner.inputs(sequence.image("rgb", k), letterbox, sequence.camera)])
        for k in (5, 4)
    )
    with torch.inference_mode():
        motions = [
            trained.network.moves(
                a["image"], b["image"], a["ray"], learner.output(trained.network, a)
            )
            for a, b in ((here, before), (before, here))
        ]
    expected = mutual_motion(*(pose_matrix(one.double())[0] for one in motions)).numpy()
    expected[:3, 3] *= MIDDLE  # distances are in units of 30 mm, and so are motions
    np.testing.assert_allclose(step, expected, atol=1e-5)
    bare = sequence.with_channels(("depth",))
    with pytest.raises(InputError, match="Training on video requires images"):
        learner.items(bare)


def test_true_distances_and_motion_cost_nothing_under_supervision():
    sequence = ellipsoid_sequence(EQUIDISTANT, SIDE, SIDE)
    learner = SfmTask(backbone=Backbone(32), supervision=1.0)
    batch = batch_of([learner.sample(sequence, k) for k in learner.items(sequence)])
    Ts = [batch[f"T_{name}_own"] for name in ("before", "after")]

    class Known(torch.nn.Module):
        """Distances and flows that are right, but for a factor and a shift of the image."""

        def __init__(self, factor, shift):
            super().__init__()
            self.factor, self.shift, self.calls, self.moves = factor, shift, 0, self

        def forward(self, image, ray):
            along = ray[:, 2].where(ray[:, 2] > 0.05, torch.nan)
            distance = (batch["depth"] / along).nan_to_num(0.03)
            return torch.log(self.factor * distance / MIDDLE)[:, None]

        def encode(self, image):
            return image

        def flow(self, own, there, ray):
            truth = true_flow(batch, Ts[self.calls % 2])
            self.calls += 1
            known = torch.isfinite(truth).all(dim=1, keepdim=True)
            return Flow(truth.nan_to_num(0.0) + self.shift, known + 1e-4)

    def labels(factor=1.0, shift=0.0):
        return float(learner.loss(Known(factor, shift), batch)["labels"])

    assert labels() < 0.3
    assert labels(factor=1.1) > labels() + 0.5 * np.log(1.1)
    # A flow that is wrong by one pixel along both axes costs √2 a neighbor, and its motion more.
    assert labels(shift=1.0) > labels() + 2.0 * np.sqrt(2.0)
    blind = replace(sequence, channels=("rgb",))
    with pytest.raises(InputError, match=r"Supervision requires depth\. ball/front has none"):
        learner.items(blind)
    assert "T_before_own" not in SfmTask(backbone=Backbone(32)).sample(sequence, 1)


def test_motion_follows_from_the_true_flow_and_distances():
    """Of a flow without error, motion is exact up to the size of a position; none gives none."""
    sequence = ellipsoid_sequence(EQUIDISTANT_128, 128, 128)
    learner = SfmTask(backbone=Backbone(128), supervision=1.0)
    batch = batch_of([learner.sample(sequence, k) for k in learner.items(sequence)])
    distance = batch["depth"] / batch["ray"][:, 2].clamp(min=0.05)
    log_distance = torch.log(distance.nan_to_num(MIDDLE) / MIDDLE)[:, None]
    for name in ("before", "after"):
        T = batch[f"T_{name}_own"]
        truth = true_flow(batch, T)
        known = torch.isfinite(truth).all(dim=1, keepdim=True)
        flow = Flow(truth.nan_to_num(0.0), known.float())
        motion = motion_from_flow(flow, batch["ray"], log_distance)
        error = MIDDLE * motion[:, 3:] - T[:, :3, 3]
        assert float((error.norm(dim=1) / T[:, :3, 3].norm(dim=1)).max()) < 0.02
        turned = pose_matrix(motion)[:, :3, :3] - T[:, :3, :3]
        assert float(turned.flatten(1).norm(dim=1).max()) < 1e-3
        still = Flow(torch.zeros_like(flow.pixels), flow.weight)
        assert float(motion_from_flow(still, batch["ray"], log_distance).abs().max()) < 1e-3
        wild = replace(flow, weight=0.0 * flow.weight)  # nothing to go by is no motion
        assert float(motion_from_flow(wild, batch["ray"], log_distance).abs().max()) < 1e-4


def test_gradients_are_those_of_finite_differences():
    image, own = _sphere(EQUIDISTANT, PLACE)
    ray, views = _rays(EQUIDISTANT), _views(EQUIDISTANT)
    neighbor, other = _sphere(EQUIDISTANT, PLACE @ np.linalg.inv(pose_matrix(MOTION)[0].numpy()))

    def loss(motion, offset):
        view = synthesize_view(neighbor, other, own + offset, pose_matrix(motion), ray, views)
        color = match_brightness(view.color, image, view.is_valid)
        error = photometric_error(color, image) + inconsistency(view)
        return (error * view.is_valid)[:, 8:24, 8:24].mean()

    motion = (0.9 * MOTION).requires_grad_(True)
    offset = torch.tensor(0.03, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(loss, (motion, offset), eps=1e-7, atol=1e-4, rtol=1e-2)


def test_brightness_is_taken_away_and_slopes_cost():
    image, own = _sphere(EQUIDISTANT, PLACE)
    valid = torch.ones(1, SIDE, SIDE, dtype=torch.bool)
    darker = 0.6 * image + 0.05
    np.testing.assert_allclose(match_brightness(darker, image, valid), image, atol=1e-4)
    assert float(photometric_error(image, image).max()) == pytest.approx(0.0, abs=1e-9)
    flat = torch.zeros_like(own)
    assert float(smoothness(flat, image)) == 0.0
    assert float(smoothness(own, image)) > 0.0
