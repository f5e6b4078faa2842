"""Claim: the motion of `sfm` beats a static camera and a constant velocity on unseen patients.

Trajectories estimated from images alone. `sfm` aligns each pair of frames directly, from the motion
of its network; `sfm, network alone` is that motion, and `direct alignment` starts from no motion
instead. The classical methods match SIFT features of consecutive frames, by OpenCV. One is the
essential matrix by RANSAC with local optimization; its translation gets the scale that the
distances of the network give to the triangulated features. The other is P3P by RANSAC, from the
features' positions at the distances of the network, and `P3P, adjusted` is that of `vrcaps
reconstruct --odometry`: P3P between each frame, the three after it and those most similar, and a
joint adjustment of all poses. A frame without enough matches repeats the previous motion. All use
the same distances. The constant velocity is the mean true motion of each sequence, which favors it.
The previous true step is a constant velocity in the sense of filters: it knows the truth up to the
frame before, so the positions that it leads to say nothing. The published weights were trained on
other patients of `weights/plans/vrcaps-motion-18.toml` as an earlier version rendered them, with
another look, so a data set made by this version also tests their robustness.

    python -m benchmarks.validation.motion [--data DATASET] [--split SPLIT] [--weights FILE]
        [--sinus FOLDER]
"""

from __future__ import annotations

import copy
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.common.scripts import parser, table, write_section
from vrcaps.camera.camera import Camera
from vrcaps.camera.lens import LensPinhole
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import invert, matrix_from_quaternion, transform_from
from vrcaps.core.units import CM
from vrcaps.formats.io import read_sources
from vrcaps.formats.shared.stored_images import read_rgb
from vrcaps.formats.shared.text_files import read_yaml
from vrcaps.learn.checkpoint import TrainedNetwork, read_weights
from vrcaps.learn.evaluation import bootstrapped_errors
from vrcaps.learn.hub import find_weights
from vrcaps.learn.motion_solver import STRIDE, Flow
from vrcaps.learn.motion_steps import common_region
from vrcaps.learn.picture_border import part_of
from vrcaps.learn.samples import frame_groups
from vrcaps.learn.tasks.sfm import SfmTask
from vrcaps.metrics.bootstrap import bootstrap
from vrcaps.metrics.trajectory import motion_baselines, motion_errors
from vrcaps.recording.frame_sequence import CAMERA_POSE, TIME, FrameSequence
from vrcaps.tools.reconstruction.estimates import with_network_depth
from vrcaps.tools.reconstruction.fusion.odometry import (
    OdometrySettings,
    estimated_poses,
    feature_views,
)
from vrcaps.tools.reconstruction.fusion.pose_adjustment import View, pose_pair
from vrcaps.tools.reconstruction.matching import matches, opencv

TOLERANCE_PX = 2.0
"""Maximum distance of an inlier from its predicted position."""
MIN_INLIERS = 12
_WINDOW = 7
"""Frames of a window; neighboring windows share one."""
HEAD = ("method", "ATE [mm]", "step, translation [mm]", "step, rotation [°]", "direction, cosine")
_MEANS = (
    "ATE after the best similarity, steps without alignment; means over sequences with 95 % "
    "intervals."
)
_SINUS = (
    "Sinus endoscopy of one patient, with poses of structure from motion; a unit of its length "
    "counts as 1 cm. The methods are those of the section before."
)
_UNITS = {"ate": 1e3, "rpe_translation": 1e3, "rpe_rotation": 180.0 / np.pi, "direction": 1.0}

Step = Callable[[View, View, float], np.ndarray | None]
"""Motion of the first camera in the second [4 4], from the features of both and the pixel angle."""


def main() -> None:
    """Estimate the trajectories, write a section of the data set and one of the sinus data."""
    made = parser(__doc__ or "")
    made.add_argument("--data", help="data set with video and poses")
    made.add_argument("--weights", default="sfm", help="weights of sfm; by default the published")
    made.add_argument("--split", default="", help="split of the data; by default all")
    made.add_argument("--sinus", type=Path, help="folder of the sinus data")
    given = made.parse_args()
    if not (given.data or given.sinus):
        made.error("Give --data, --sinus, or both.")
    trained = read_weights(find_weights(given.weights), task="sfm")
    if given.data:
        sequences = [s for s in read_sources([given.data]) if given.split in ("", s.split)]
        about = " ".join((__doc__ or "").split("    python")[0].split())
        text = f"## Motion\n\n{about} {_MEANS}\n\n{_tables(trained, sequences)}"
        write_section(given.out, Path(__file__), text.rstrip())
    if given.sinus:
        tables = "".join(_sinus_tables(trained, read_sinus_sequence(given.sinus)))
        text = f"## Motion of a real endoscope\n\n{_SINUS} {_MEANS}\n\n{tables}"
        write_section(given.out, Path(__file__), text.rstrip(), part="sinus")


def _tables(trained: TrainedNetwork, sequences: Sequence[FrameSequence]) -> str:
    """Tables of all sequences, and of those with a frozen and a moving wall."""
    parts: dict[str, list[FrameSequence]] = {"All": list(sequences)}
    for one in sequences:
        parts.setdefault("Moving wall" if is_moving(one) else "Frozen wall", []).append(one)
    errors = {one.name: errors_of(trained, one) for one in sequences}
    return "".join(_table(name, [errors[s.name] for s in own], own) for name, own in parts.items())


def _table(
    name: str, rows: Sequence[Mapping[str, Mapping[str, float]]], sequences: Sequence[FrameSequence]
) -> str:
    """Section of a table of some sequences."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # the mean of no known value
        found, groups = bootstrapped_errors(rows, sequences)
    lines = [
        [method, *(_cell(scores[name], unit) for name, unit in _UNITS.items())]
        for method, scores in found.items()
    ]
    count = sum(map(len, sequences))
    over = groups if groups.startswith("1 ") else f"intervals over {groups}"
    head = f"**{name}**: {count} frames; {over}."
    return f"{head}\n\n{table(HEAD, lines)}\n\n{_ratios(rows, sequences)}\n\n"


def _ratios(
    rows: Sequence[Mapping[str, Mapping[str, float]]], sequences: Sequence[FrameSequence]
) -> str:
    """Mean ATE of `sfm` relative to that of the other methods, with intervals."""
    groups = np.array(frame_groups([(one, 0) for one in sequences])[0])
    ratios = []
    for name in rows[0]:
        own, other = (np.array([row[one]["ate"] for row in rows]) for one in ("sfm", name))
        if name == "sfm" or not np.isfinite(other).all():
            continue

        def ratio(items: np.ndarray, own: np.ndarray = own, other: np.ndarray = other) -> float:
            return float(own[items].mean() / other[items].mean())

        found = bootstrap(ratio, len(rows), groups=groups)
        ratios.append(f"{name} {_shown(found.value, found.low, found.high, '.2f')}")
    return f"ATE of `sfm` relative to that of others: {', '.join(ratios)}."


def _sinus_tables(trained: TrainedNetwork, sequence: FrameSequence) -> list[str]:
    """Tables of the whole sequence and of its windows; each baseline is fitted to each of them."""
    found = estimates_of(trained, sequence)
    truth = sequence.Ts_world_camera
    whole = errors_of_estimates(found, truth)
    starts = range(0, len(sequence) - _WINDOW + 1, _WINDOW - 1)
    windows, rows = [], []
    for number, start in enumerate(starts):
        part = slice(start, start + _WINDOW)
        cut = {name: poses[part] for name, poses in found.items()}
        rows.append(errors_of_estimates(cut, truth[part]))
        window = sequence.subset(range(start, start + _WINDOW))
        windows.append(replace(window, name=f"{sequence.name}-{number}"))
    return [
        _table("Whole sequence", [whole], [sequence]),
        _table(f"Windows of {_WINDOW} frames", rows, windows),
    ]


def is_moving(sequence: FrameSequence) -> bool:
    """Whether gas moves the wall of a recording; false for external data."""
    if sequence.episode is None:
        return False
    return bool(getattr(sequence.episode.scenario.motion, "insufflation", ()))


def read_sinus_sequence(folder: Path) -> FrameSequence:
    """Frames of the sinus data within their black border, with the poses of structure from motion.

    A unit of length counts as a centimeter.
    """
    views = [int(line) for line in (folder / "visible_view_indexes").read_text().split()]
    images = [read_rgb(folder / f"{view:08d}.jpg") for view in views]
    numbers = np.array((folder / "camera_intrinsics_per_view").read_text().split(), float)
    height, width = images[0].shape[:2]
    fx, fy, cx, cy = numbers[:4] * (0.5 if numbers[2] > 0.75 * width else 1.0)
    poses = read_yaml(folder / "motion.yaml")["poses[]"]
    Ts = []
    for number in range(len(views)):
        place, turn = (poses[f"poses[{number}]"][name] for name in ("position", "orientation"))
        rotation = matrix_from_quaternion(np.array([float(turn[axis]) for axis in "wxyz"]))
        Ts.append(transform_from(rotation, CM * np.array([float(place[axis]) for axis in "xyz"])))
    values = {TIME: np.arange(len(views)) / 30.0, CAMERA_POSE: np.stack(Ts)}
    camera = Camera("sinus", LensPinhole(fx=fx, fy=fy, cx=cx, cy=cy), width, height)
    whole = FrameSequence(
        "sinus", ("rgb",), values, lambda channel, index: images[index], camera=camera
    )
    rows, columns = common_region(whole, np.arange(len(views)))
    return replace(
        whole,
        camera=part_of(camera, rows, columns),
        load=lambda channel, index: np.ascontiguousarray(images[index][rows, columns]),
    )


def errors_of(trained: TrainedNetwork, sequence: FrameSequence) -> dict[str, dict[str, float]]:
    """Errors of each method on a sequence."""
    return errors_of_estimates(estimates_of(trained, sequence), sequence.Ts_world_camera)


def estimates_of(trained: TrainedNetwork, sequence: FrameSequence) -> dict[str, np.ndarray]:
    """Trajectory [n 4 4] of each method."""
    task, network = trained.task, trained.network
    assert isinstance(task, SfmTask)
    still = copy.copy(network)
    still._modules = {**network._modules, "moves": NoFlow()}
    alone = replace(task, aligns=False)
    found = {
        "sfm": task.trajectory(network, sequence).Ts_world_camera,
        "sfm, network alone": alone.trajectory(network, sequence).Ts_world_camera,
        "direct alignment": task.trajectory(still, sequence).Ts_world_camera,
    }
    measured = with_network_depth(sequence, trained)
    views, pitch = feature_views(measured, OdometrySettings())
    found["essential matrix"] = chain(views, pitch, essential_step)
    found["P3P"] = chain(views, pitch, p3p_step)
    found["P3P, adjusted"] = adjusted_trajectory(measured)
    return found


def errors_of_estimates(
    found: Mapping[str, np.ndarray], truth: np.ndarray
) -> dict[str, dict[str, float]]:
    """Errors of estimated trajectories and of the baselines."""
    errors = {
        name: motion_errors(poses, truth)
        for name, poses in {**found, **motion_baselines(truth)}.items()
    }
    repeated = {"ate": float("nan")}
    return {**errors, "previous true step": motion_errors(extrapolated(truth), truth) | repeated}


def extrapolated(truth: np.ndarray) -> np.ndarray:
    """Trajectory [n 4 4] whose steps are those before; the first is none."""
    steps = invert(truth[:-1]) @ truth[1:]
    poses = [np.eye(4)]
    for step in [np.eye(4), *steps[:-1]]:
        poses.append(poses[-1] @ step)
    return np.stack(poses)


class NoFlow(torch.nn.Module):
    """Motion network that estimates no flow, for alignment without a start."""

    def encode(self, image: torch.Tensor) -> torch.Tensor:
        """Return no features."""
        return image[:, :0]

    def flow(self, own: torch.Tensor, there: torch.Tensor, ray: torch.Tensor) -> Flow:
        """Return a flow of zero."""
        side = ray.shape[-1] // STRIDE
        return Flow(ray.new_zeros(len(ray), 2, side, side), ray.new_ones(len(ray), 1, side, side))


def chain(views: list[View], pitch: float, step: Step) -> np.ndarray:
    """Trajectory of steps between consecutive frames [n 4 4]."""
    poses, last = [np.eye(4)], np.eye(4)
    for one, other in pairwise(views):
        T_second_first = step(one, other, TOLERANCE_PX * pitch)
        last = last if T_second_first is None else invert(T_second_first)
        poses.append(poses[-1] @ last)
    return np.stack(poses)


def adjusted_trajectory(sequence: FrameSequence) -> np.ndarray:
    """Trajectory [n 4 4] by P3P and pose adjustment; static if no two frames overlap.

    A frame without a pose repeats the last known motion between neighboring frames.
    """
    try:
        found = estimated_poses(sequence, OdometrySettings())
    except InputError:
        return np.tile(np.eye(4), (len(sequence), 1, 1))
    known = dict(zip(found.frames.tolist(), found.Ts_first_camera, strict=True))
    poses, last = [np.eye(4)], np.eye(4)
    for index in range(1, len(sequence)):
        poses.append(known.get(index, poses[-1] @ last))
        if {index - 1, index} <= known.keys():
            last = invert(poses[-2]) @ poses[-1]
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
    # RANSAC with local optimization, which has a fixed seed; plain RANSAC is less accurate.
    matrix, _ = cv2.findEssentialMat(
        first, second, np.eye(3), method=cv2.USAC_ACCURATE, prob=0.999, threshold=tolerance
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


def _cell(values: Sequence[float], unit: float) -> str:
    value, low, high = (unit * one for one in values)
    if not np.isfinite(value):
        return "–"
    return _shown(value, low, high, ".3g")


def _shown(value: float, low: float, high: float, form: str) -> str:
    """Value with its interval, if that has an extent."""
    shown = f"{value:{form}}"
    return shown if low == high else f"{shown} [{low:{form}}, {high:{form}}]"


if __name__ == "__main__":
    main()
