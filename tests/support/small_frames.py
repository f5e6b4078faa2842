"""Frames to learn from: twenty small images whose depth, masks and classes follow from them."""

from functools import partial

import numpy as np

from vrcaps.camera.camera import Camera
from vrcaps.camera.lens import LensPinhole
from vrcaps.recording.frame_sequence import FrameSequence

SIDE, COUNT = 48, 20
LENS = LensPinhole(fx=30.0, fy=30.0, cx=23.5, cy=23.5)
NAMES = ("normal", "polyp")


def image_of(channel: str, index: int, seed: int = 0) -> np.ndarray:
    """A round wall, nearer at a bright blob; every second image has a red disk."""
    rng = np.random.default_rng([seed, index])
    y, x = np.mgrid[:SIDE, :SIDE]
    cx, cy = rng.uniform(10, 38, 2)
    near = np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / 200.0)
    depth = (0.05 - 0.035 * near).astype(np.float32)
    disk = (x - rng.uniform(14, 34)) ** 2 + (y - rng.uniform(14, 34)) ** 2 < 64
    disk &= index % 2 == 1
    if channel == "depth":
        return depth
    if channel == "instance":
        return disk.astype(np.uint16)
    light = np.clip((0.02 / depth) ** 2 * 160.0, 0, 255)
    rgb = np.stack([light, 0.7 * light, 0.6 * light], axis=-1)
    rgb[disk] = [220, 30, 30]
    return rgb.astype(np.uint8)


def small_sequence(seed: int = 0, name: str = "small", **more) -> FrameSequence:
    """Twenty frames with depth, masks and classes."""
    values = {
        "time": np.arange(COUNT, dtype=float),
        "exposure": np.ones(COUNT),
        "class": np.array([NAMES[k % 2] for k in range(COUNT)]),
    }
    return FrameSequence(
        name,
        ("rgb", "depth", "instance"),
        values,
        partial(image_of, seed=seed),
        Camera("front", LENS, SIDE, SIDE),
        **more,
    )
