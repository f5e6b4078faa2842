"""Errors of trajectories, their baselines, and layers that die."""

from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed")
pytest.importorskip("segmentation_models_pytorch", reason="its package is not installed")

from scipy.spatial.transform import Rotation  # noqa: E402

from tests.support.ellipsoid_sequence import ellipsoid_sequence  # noqa: E402
from tests.support.small_frames import small_sequence  # noqa: E402
from vrcaps.camera.lens import LensEquidistant  # noqa: E402
from vrcaps.core.errors import InputError  # noqa: E402
from vrcaps.core.geometry import transform_from  # noqa: E402
from vrcaps.learn.checkpoint import TrainedNetwork, write_weights  # noqa: E402
from vrcaps.learn.evaluation import compared_sequences  # noqa: E402
from vrcaps.learn.initialize import initialized_network  # noqa: E402
from vrcaps.learn.networks import Backbone  # noqa: E402
from vrcaps.learn.picture_border import Letterbox  # noqa: E402
from vrcaps.learn.samples import batch_of, samples_of  # noqa: E402
from vrcaps.learn.tasks.classification import ClassificationTask  # noqa: E402
from vrcaps.learn.tasks.depth import DepthTask  # noqa: E402
from vrcaps.learn.tasks.sfm import SfmTask  # noqa: E402
from vrcaps.learn.training import dead_features, require_alive  # noqa: E402
from vrcaps.metrics.trajectory import (  # noqa: E402
    absolute_trajectory_error,
    aligned_rmse,
    motion_baselines,
    motion_errors,
)


def walk(count: int = 20, seed: int = 0) -> np.ndarray:
    """A winding trajectory of a camera."""
    rng = np.random.default_rng(seed)
    poses = [np.eye(4)]
    for _ in range(count - 1):
        turn = Rotation.from_rotvec(rng.normal(0.0, 0.1, 3)).as_matrix()
        poses.append(poses[-1] @ transform_from(turn, rng.normal([0, 0, 1e-3], 4e-4)))
    return np.stack(poses)


def test_the_aligned_error_is_that_of_an_explicit_alignment() -> None:
    truth, estimate = walk(), walk(seed=1)
    errors = absolute_trajectory_error(estimate, truth)
    given = aligned_rmse(estimate[:, :3, 3], truth[:, :3, 3])
    assert given == pytest.approx(float(np.sqrt((errors**2).mean())), rel=1e-9)


def test_a_scaled_copy_has_no_position_error_and_a_static_camera_has_all() -> None:
    truth = walk()
    double = truth.copy()
    double[:, :3, 3] *= 2.0
    found = motion_errors(double, truth)
    assert found["ate"] < 1e-9 and found["direction"] == pytest.approx(1.0)
    steps = np.linalg.norm(np.diff(truth[:, :3, 3], axis=0), axis=1)
    assert found["rpe_translation"] == pytest.approx(steps.mean())
    still = motion_errors(motion_baselines(truth)["static"], truth)
    spread = truth[:, :3, 3] - truth[:, :3, 3].mean(axis=0)
    assert still["ate"] == pytest.approx(float(np.sqrt((spread**2).sum(axis=1).mean())))
    assert still["direction"] == 0.0


def test_constant_velocity_is_exact_for_a_screw_and_not_for_its_reverse() -> None:
    step = transform_from(
        Rotation.from_rotvec([0.05, 0.1, 0.0]).as_matrix(), np.array([0.0, 0.0, 1e-3])
    )
    poses = [np.eye(4)]
    for _ in range(15):
        poses.append(poses[-1] @ step)
    truth = np.stack(poses)
    found = motion_errors(motion_baselines(truth)["constant velocity"], truth)
    assert found["ate"] < 1e-9 and found["rpe_rotation"] < 1e-7
    back = motion_errors(truth[::-1], truth)
    assert back["direction"] < -0.9


def test_a_network_is_compared_with_static_and_constant_velocity() -> None:
    learner = SfmTask(backbone=Backbone(32))
    trained = TrainedNetwork(learner, learner.network(is_pretrained=False).eval(), {})
    lens = LensEquidistant(focal=13.0, cx=15.5, cy=15.5, max_angle=1.4)
    sequence = ellipsoid_sequence(lens, 32, 32)
    table, groups = compared_sequences(trained, [sequence])
    assert set(table) == {"network", "static", "constant velocity"} and groups == "1 sequence"
    assert set(table["static"]) == {"ate", "rpe_translation", "rpe_rotation", "direction"}
    assert compared_sequences(trained, [small_sequence()]) == ({}, "")  # no poses


def test_a_dead_layer_stops_training() -> None:
    """A classifier whose last activation is always zero, as of a too large learning rate."""
    learner = ClassificationTask(("normal", "polyp"), backbone=Backbone(32))
    torch.manual_seed(0)
    network = learner.network(is_pretrained=False).eval()
    trained = TrainedNetwork(learner, network, {})
    samples = samples_of(learner, [small_sequence()])
    known = [samples.next(k) for k in range(4)]
    assert max(dead_features(trained, known).values()) < 1.0
    require_alive(trained, known, 7)
    torch.nn.init.constant_(network.net.bn2.weight, 0.0)  # type: ignore[union-attr,arg-type]
    torch.nn.init.constant_(network.net.bn2.bias, -1.0)  # type: ignore[union-attr,arg-type]
    with pytest.raises(
        InputError, match=r"dead at step 7: all inputs of its layer net\.classifier"
    ):
        require_alive(trained, known, 7)
    require_alive(trained, known[:1], 7)  # one image cannot differ


def test_motion_cannot_be_constant_in_a_new_network() -> None:
    """Other frames give another flow, from random weights on."""
    learner = SfmTask(backbone=Backbone(64))
    torch.manual_seed(0)
    trained = TrainedNetwork(learner, learner.network(is_pretrained=False).eval(), {})
    samples = [learner.inputs(one, box, camera) for one, box, camera in _images()]
    motion = trained.outputs(batch_of(samples))["motion"]
    assert (np.ptp(motion, axis=0) > 1e-4).all()


def _images():
    sequence = small_sequence()
    return [
        (sequence.image("rgb", k), Letterbox(48, 48, 64), sequence.camera) for k in (0, 3, 7, 9)
    ]


def test_distances_start_as_those_of_depth(tmp_path) -> None:
    """From a checkpoint of depth, distance along a ray is depth over the cosine."""
    depth = DepthTask(backbone=Backbone(32))
    torch.manual_seed(0)
    network = depth.network(is_pretrained=False).eval()
    write_weights(tmp_path / "depth.safetensors", depth, network, {"origin": "scratch"})
    learner = SfmTask(backbone=Backbone(32))
    own = initialized_network(learner, str(tmp_path / "depth.safetensors")).eval()
    image, _, camera = _images()[0]
    batch = batch_of([depth.inputs(image, Letterbox(48, 48, 32), camera)])
    with torch.inference_mode():
        z, distance = depth.output(network, batch), learner.output(own, batch)
    cosine = batch["ray"][:, 2:]
    inside = cosine[0, 0] > 0.05
    expected = (z - torch.log(cosine.clamp(min=0.05)))[0, 0][inside]
    np.testing.assert_allclose(distance[0, 0][inside], expected, atol=0.02)  # weights in 16 bits
