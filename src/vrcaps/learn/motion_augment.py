"""Random mirroring, transposition and crops of video frames with their flow and motion.

A crop, mirrored or transposed, is what another camera would see: rays and labels are transformed
with the images. Samples hold images and maps [s s ...], flows [h w 2] named `flow_…` in pixels of
the sample, and motions [4 4] named `T_…`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vrcaps.learn.task import Sample

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
