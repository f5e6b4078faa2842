"""Claim: the motion of `sfm` beats a static camera, a constant velocity and classical odometry.

Trajectories of unseen patients, estimated from images alone. The classical methods match SIFT
features of consecutive frames, by OpenCV. One is the essential matrix by RANSAC; its translation
gets the scale that the distances of the network give to the triangulated features. The other is P3P
by RANSAC, from the features' positions at the distances of the network. A frame without enough
matches repeats the previous motion. The constant velocity is the mean true motion of each sequence,
which favors it.

    python -m benchmarks.validation.motion --data DATASET --weights FILE [--split SPLIT]
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common.scripts import parser, table, write_section
from vrcaps.core.geometry import invert, transform_from
from vrcaps.formats.io import read_sources
from vrcaps.learn.checkpoint import TrainedNetwork, read_weights
from vrcaps.learn.evaluation import bootstrapped_errors
from vrcaps.learn.motion_errors import motion_baselines, motion_errors
from vrcaps.learn.tasks.sfm import SfmTask
from vrcaps.recording.frame_sequence import FrameSequence
from vrcaps.tools.reconstruction.estimates import with_network_depth
from vrcaps.tools.reconstruction.fusion.odometry import OdometrySettings, feature_views
from vrcaps.tools.reconstruction.fusion.pose_adjustment import View, pose_pair
from vrcaps.tools.reconstruction.matching import matches, opencv

TOLERANCE_PX = 2.0
"""Maximum distance of an inlier from its predicted position."""
MIN_INLIERS = 12
HEAD = ("method", "ATE [mm]", "step, translation [mm]", "step, rotation [°]", "direction, cosine")
_UNITS = {"ate": 1e3, "rpe_translation": 1e3, "rpe_rotation": 180.0 / np.pi, "direction": 1.0}

Step = Callable[[View, View, float], np.ndarray | None]
"""Motion of the first camera in the second [4 4], from the features of both and the pixel angle."""


def main() -> None:
    """Estimate the trajectories, write the table."""
    made = parser(__doc__ or "")
    made.add_argument("--data", required=True, help="data set with video and poses")
    made.add_argument("--weights", required=True, help="weights of sfm")
    made.add_argument("--split", default="", help="split of the data; by default all")
    given = made.parse_args()
    trained = read_weights(given.weights, task="sfm")
    sequences = [s for s in read_sources([given.data]) if given.split in ("", s.split)]
    rows = [errors_of(trained, one) for one in sequences]
    found, groups = bootstrapped_errors(rows, sequences)
    lines = [
        [method, *(_cell(scores[name], unit) for name, unit in _UNITS.items())]
        for method, scores in found.items()
    ]
    text = f"""## Motion

{" ".join((__doc__ or "").split("    python")[0].split())} {len(sequences)} sequences of
{sum(map(len, sequences))} frames; 95 % intervals over {groups}. ATE after the best similarity,
steps without alignment.

{table(HEAD, lines)}"""
    write_section(given.out, Path(__file__), text)


def errors_of(trained: TrainedNetwork, sequence: FrameSequence) -> dict[str, dict[str, float]]:
    """Errors of each method on a sequence."""
    task, truth = trained.task, sequence.Ts_world_camera
    assert isinstance(task, SfmTask)
    found = {"sfm": task.trajectory(trained.network, sequence).Ts_world_camera}
    views, pitch = feature_views(with_network_depth(sequence, trained), OdometrySettings())
    found["essential matrix"] = chain(views, pitch, essential_step)
    found["P3P"] = chain(views, pitch, p3p_step)
    found |= motion_baselines(truth)
    return {name: motion_errors(poses, truth) for name, poses in found.items()}


def chain(views: list[View], pitch: float, step: Step) -> np.ndarray:
    """Trajectory of steps between consecutive frames [n 4 4]."""
    poses, last = [np.eye(4)], np.eye(4)
    for one, other in pairwise(views):
        T_second_first = step(one, other, TOLERANCE_PX * pitch)
        last = last if T_second_first is None else invert(T_second_first)
        poses.append(poses[-1] @ last)
    return np.stack(poses)


def p3p_step(one: View, other: View, tolerance: float) -> np.ndarray | None:
    """Motion by P3P and RANSAC."""
    pair = pose_pair((0, 1), one, other, tolerance)
    return None if pair is None else pair.T_second_first


def essential_step(one: View, other: View, tolerance: float) -> np.ndarray | None:
    """Motion by the essential matrix; its scale is the median over features with a distance."""
    cv2: Any = opencv()
    matched = matches(one.descriptors, other.descriptors)
    rays = [one.rays[matched[:, 0]], other.rays[matched[:, 1]]]
    is_front = (rays[0][:, 2] > 0.2) & (rays[1][:, 2] > 0.2)  # a plane at distance 1
    first, second = (ray[is_front, :2] / ray[is_front, 2:] for ray in rays)
    if len(first) < MIN_INLIERS:
        return None
    cv2.setRNGSeed(0)
    matrix, _ = cv2.findEssentialMat(
        first, second, np.eye(3), method=cv2.RANSAC, prob=0.999, threshold=tolerance
    )
    if matrix is None or matrix.shape != (3, 3):
        return None
    count, rotation, shift, mask, points = cv2.recoverPose(
        matrix, first, second, np.eye(3), distanceThresh=1e3
    )
    inliers = mask[:, 0] > 0
    if count < MIN_INLIERS:
        return None
    triangulated = np.linalg.norm(points[:3, inliers] / points[3, inliers], axis=0)
    known = np.linalg.norm(one.points[matched[is_front, 0]][inliers], axis=1)
    return transform_from(rotation, shift[:, 0] * float(np.median(known / triangulated)))


def _cell(values: tuple[float, float, float], unit: float) -> str:
    value, low, high = (unit * one for one in values)
    return f"{value:.3g} [{low:.3g}, {high:.3g}]"


if __name__ == "__main__":
    main()
