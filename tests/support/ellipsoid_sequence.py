"""Frames of a camera that moves in an ellipsoid: all channels in closed form, for any lens."""

from dataclasses import replace
from functools import cache, partial

import numpy as np

from vrcaps.camera.camera import Camera, camera_rays, in_image, pixel_grid
from vrcaps.core.geometry import invert, rotation_from_vector, transform_from, transform_points
from vrcaps.recording.frame_sequence import CAMERA_POSE, TIME, FrameSequence

AXES = np.array([0.031, 0.024, 0.019])
"""Semi-axes of the ellipsoid, which has its center at the world's origin [m]."""
CHANNELS = ("rgb", "depth", "normal", "label", "flow_backward")


def ellipsoid_sequence(
    lens, width, height, *, frames=5, name="ball/front", mount=None
) -> FrameSequence:
    """Frames of a path in the ellipsoid, seen through a lens, at a pose `mount` on the path."""
    camera = Camera(name.split("/")[-1], lens, width, height)
    times = 0.5 + 0.25 * np.arange(frames)
    step = np.arange(frames)[:, None]
    turns = np.array([0.3, -0.2, 0.1]) + step * np.array([0.04, -0.08, 0.06])
    places = 1e-3 * (np.array([-4.0, 2.0, -1.0]) + step * np.array([1.0, 0.5, -0.7]))
    poses = transform_from(rotation_from_vector(turns), places)
    poses = poses if mount is None else poses @ mount
    values = {TIME: times, CAMERA_POSE: poses}
    load = partial(_channel, camera, poses)
    labels = ("background", "left", "right")
    return FrameSequence(name, CHANNELS, values, load, camera, labels)


def spotted_sequence(lens, side, *, frames):
    """Square images and depth of the path, with the wall spotted all over, for SIFT features."""
    plain = ellipsoid_sequence(lens, side, side, frames=frames)
    chance = np.random.default_rng(4)
    waves = chance.standard_normal((60, 3)) * chance.uniform(300.0, 1800.0, (60, 1))
    phases = chance.uniform(0.0, 2.0 * np.pi, 60)

    def load(channel: str, index: int) -> np.ndarray:
        if channel != "rgb":
            return plain.load(channel, index)
        rays = lens.unproject(pixel_grid(side, side))
        points = rays / rays[..., 2:] * plain.image("depth", index)[..., None]
        pose = plain.Ts_world_camera[index]
        world = transform_points(pose, points.reshape(-1, 3)).reshape(rays.shape)
        value = 120.0 + 12.0 * np.sin(world @ waves.T + phases).sum(axis=-1)
        return np.clip(np.nan_to_num(value)[..., None] * [1.0, 0.6, 0.5], 0, 255).astype(np.uint8)

    return replace(plain, channels=("rgb", "depth"), load=load)


def blanked(sequence, blank):
    """Copy of a sequence whose frames of these indices show nothing."""

    def load(channel: str, index: int) -> np.ndarray:
        image = sequence.load(channel, index)
        return np.full_like(image, 90) if channel == "rgb" and index in blank else image

    return replace(sequence, load=load)


def off_the_wall(points_world: np.ndarray) -> np.ndarray:
    """Distance of points from the ellipsoid, to first order [m]."""
    scaled = points_world / AXES
    implicit = (scaled**2).sum(axis=-1) - 1.0
    return np.abs(implicit) / np.linalg.norm(2.0 * scaled / AXES, axis=-1)


def _channel(camera: Camera, poses: np.ndarray, channel: str, index: int) -> np.ndarray:
    if channel == "flow_backward":
        return _flow(camera, poses, index)
    return _images(camera, poses[index].tobytes())[channel]


@cache
def _images(camera: Camera, pose: bytes) -> dict[str, np.ndarray]:
    T_world_camera = np.frombuffer(pose).reshape(4, 4)
    rays = camera_rays(camera).astype(float)
    origin = T_world_camera[:3, 3] / AXES
    along = rays @ T_world_camera[:3, :3].T / AXES
    a, b = (along**2).sum(axis=-1), along @ origin
    distance = (np.sqrt(b**2 - a * (origin @ origin - 1.0)) - b) / a
    position = transform_points(T_world_camera, (distance[..., None] * rays).reshape(-1, 3))
    inward = -position / AXES**2 @ T_world_camera[:3, :3]
    inward /= np.linalg.norm(inward, axis=-1, keepdims=True)
    depth = distance * rays[..., 2]
    seen = depth > 0.0
    waves = np.sin(position.reshape(rays.shape) * [900.0, 700.0, 800.0])
    return {
        "rgb": np.where(seen[..., None], 128.0 + 100.0 * waves, 0.0).astype(np.uint8),
        "depth": np.where(seen, depth, np.nan).astype(np.float32),
        "normal": np.where(seen[..., None], inward.reshape(rays.shape), np.nan).astype(np.float32),
        "label": (seen * np.where(position[:, 0].reshape(seen.shape) < 0.0, 1, 2)).astype(np.uint8),
        "position": np.where(seen[..., None], position.reshape(rays.shape), np.nan),
    }


def _flow(camera: Camera, poses: np.ndarray, index: int) -> np.ndarray:
    pixels = pixel_grid(camera.width, camera.height)
    if index == 0:
        return np.full(pixels.shape, np.nan, np.float32)
    points = _images(camera, poses[index].tobytes())["position"].reshape(-1, 3)
    before = camera.lens.project(transform_points(invert(poses[index - 1]), points))
    before = before.reshape(pixels.shape)
    seen = in_image(camera, before)[..., None]
    return np.where(seen, before - pixels, np.nan).astype(np.float32)
