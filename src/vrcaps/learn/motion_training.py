"""Training of the motion network: augmentation of video frames, and losses of flow and motion.

A crop, mirrored or transposed, is what another camera would see: rays and labels are transformed
with the images. Samples hold images and maps [s s ...], flows [h w 2] named `flow_…` in pixels of
the sample, and motions [4 4] named `T_…`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from vrcaps.learn.motion_solver import STRIDE, Flow, at_positions
from vrcaps.learn.task import Batch, Sample
from vrcaps.learn.tasks.depth import MIDDLE

if TYPE_CHECKING:
    from numpy.typing import NDArray


FLOW, MOTION = "flow_", "T_"
"""First letters of the names of flows and motions."""
_WHOLE = 0.99
"""Minimum length of a mean of unit rays, see `motion_network`."""


def mirrored(sample: Sample, axis: int) -> Sample:
    """Mirror a sample along columns (axis 1) or rows (axis 0)."""
    component = 1 - axis
    sign = np.ones(3, np.float32)
    sign[component] = -1.0
    flipped = np.diag([*sign, 1.0]).astype(np.float32)
    result = dict(sample)
    for name, array in sample.items():
        if name.startswith(MOTION):
            result[name] = flipped @ array @ flipped
        elif _is_map(array):
            turned = np.flip(array, axis)
            is_vector = name == "ray" or name.startswith(FLOW)
            vectors = turned * sign[: array.shape[-1]] if is_vector else turned
            result[name] = np.ascontiguousarray(vectors)
    return result


def transposed(sample: Sample) -> Sample:
    """Exchange rows and columns of a sample."""
    order = np.array([1, 0, 2, 3])
    result = dict(sample)
    for name, array in sample.items():
        if name.startswith(MOTION):
            result[name] = array[np.ix_(order, order)]
        elif _is_map(array):
            turned = array.swapaxes(0, 1)
            is_vector = name == "ray" or name.startswith(FLOW)
            vectors = turned[..., order[: array.shape[-1]]] if is_vector else turned
            result[name] = np.ascontiguousarray(vectors)
    return result


def cropped(sample: Sample, min_crop: float, rng: np.random.Generator) -> Sample:
    """Crop a random square from a sample and resize it to the sample's size.

    Args:
        sample: Frames with `image` and `ray`.
        min_crop: Minimum side, relative to the image.
        rng: Random generator for the crop.
    """
    part = float(rng.uniform(min_crop, 1.0))
    start = rng.uniform(0.0, 1.0 - part, 2)
    box = (*start, *(start + part))
    result = dict(sample)
    for name, array in sample.items():
        if name.startswith(MOTION) or not _is_map(array):
            continue
        if array.dtype == np.uint8:
            result[name] = _resized(array, box)
            continue
        if array.ndim == 2:
            result[name] = _nearest(array, box)
            continue
        planes = [_resized(np.ascontiguousarray(one), box) for one in np.moveaxis(array, -1, 0)]
        result[name] = np.stack(planes, axis=-1) / (part if name.startswith(FLOW) else 1.0)
    length = np.linalg.norm(result["ray"], axis=-1, keepdims=True)
    unit = result["ray"] / np.maximum(length, 1e-6)
    result["ray"] = np.where(length > _WHOLE, unit, 0.0).astype(np.float32)
    return result


def _is_map(array: object) -> bool:
    """Whether an entry of a sample is an array over rows and columns."""
    return isinstance(array, np.ndarray) and array.ndim >= 2 and array.shape[0] == array.shape[1]


def _resized(array: NDArray, box: tuple[float, ...]) -> NDArray:
    """Part of a square image or plane in its own size, by linear interpolation."""
    from PIL import Image

    size = array.shape[0]
    limits = tuple(size * one for one in box)
    image = Image.fromarray(array)
    return np.asarray(image.resize((size, size), Image.Resampling.BILINEAR, box=limits))


def _nearest(array: NDArray, box: tuple[float, ...]) -> NDArray:
    """Part of a square map in its own size, by nearest neighbor."""
    size = array.shape[0]
    centers = (np.arange(size) + 0.5) / size
    columns, rows = (
        (size * (low + centers * (high - low))).astype(int)
        for low, high in zip(box[:2], box[2:], strict=True)
    )
    return np.ascontiguousarray(array[np.ix_(rows, columns)])


_MAX_FLOW = 28.0
"""Maximum true flow that is used in training [px]."""
_COARSE, _LIKELIHOOD = 0.5, 0.2
"""Weights of the flow of the coarse grid and of the standard deviation, relative to the flow."""
_SHORT = 5e-4
"""Length of a translation below which its error is not relative to its own [m]."""
MIN_COSINE = 0.05
"""Minimum cosine of the angle between a ray and the axis: near a right angle, depth along the axis
does not determine the distance."""


def true_flow(batch: Batch, T_other_own: Tensor) -> Tensor:
    """Compute the flow of a static wall [b 2 h w], in pixels, at positions of `MotionNetwork`.

    It is NaN where no distance is known.

    Args:
        batch: `depth` [b s s], `ray` [b 3 s s] and `view`, letterbox and camera of each image.
        T_other_own: Pose of the frame's camera in the neighbor's [m] [b 4 4].
    """
    size = batch["ray"].shape[-1]
    distance = functional.avg_pool2d(distances_of(batch)[:, None], STRIDE)
    points = (distance * at_positions(batch["ray"])).flatten(2)
    moved = T_other_own[:, :3, :3] @ points + T_other_own[:, :3, 3:]
    flows = []
    for (letterbox, camera), start, end in zip(
        batch["view"], points.transpose(1, 2), moved.transpose(1, 2), strict=True
    ):
        pixels = [torch.stack(letterbox.to_square(camera.lens.project(p))) for p in (start, end)]
        flows.append((pixels[1] - pixels[0]).view(2, size // STRIDE, -1))
    return torch.stack(flows)


def flow_error(flow: Flow, truth: Tensor) -> Tensor:
    """Error of a flow [px]: of both grids, and the likelihood of its standard deviation.

    The last is −ln of the density exp(−r / σ) / (2π σ²) of the distance r from the true flow, a
    Laplace distribution in two dimensions.
    """
    pixels, deviation = flow.pixels, flow.weight[:, 0] ** -0.5
    known = torch.isfinite(truth).all(dim=1)
    known = known & (torch.nan_to_num(truth).abs() < _MAX_FLOW).all(dim=1)
    distance = _distance(pixels, truth, known)
    error = distance + _LIKELIHOOD * (distance / deviation + 2.0 * torch.log(deviation))
    total = (error * known).sum() / known.sum().clamp(min=1)
    if flow.coarse is None:
        return total
    large = functional.interpolate(flow.coarse, size=truth.shape[-2:], mode="bilinear")
    coarse = _distance(large, truth, known)
    return total + _COARSE * (coarse * known).sum() / known.sum().clamp(min=1)


def _distance(pixels: Tensor, truth: Tensor, known: Tensor) -> Tensor:
    """Distance of a flow from the true one [b h w] [px], smooth at 0."""
    difference = torch.where(known[:, None], pixels - truth, 0.0)
    return ((difference**2).sum(dim=1) + 1e-4).sqrt()


def motion_error(motion: Tensor, T_other_own: Tensor) -> Tensor:
    """Error of motions [b 4 4]: ln(1 + relative error of the translation + error of the rotation).

    Rotations are in units of 0.02 rad, about a pixel; translations below half a millimeter count as
    of that length.
    """
    turned = (motion[:, :3, :3] - T_other_own[:, :3, :3]).flatten(1).norm(dim=1)
    shifted = (MIDDLE * motion[:, :3, 3] - T_other_own[:, :3, 3]).norm(dim=1)
    length = T_other_own[:, :3, 3].norm(dim=1).clamp(min=_SHORT)
    return torch.log1p(turned / 0.02 + shifted / length).mean()


def distances_of(batch: Batch) -> Tensor:
    """True distances along rays [b s s]."""
    along = batch["ray"][:, 2]
    return batch["depth"] / along.where(along > MIN_COSINE, np.nan)
