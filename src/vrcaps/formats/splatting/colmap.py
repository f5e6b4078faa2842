"""COLMAP: text models with rigs, for structure from motion, Gaussian splatting and radiance fields.

A folder per episode holds `images/` and the model in `sparse/0/`. Poses are world to camera,
quaternions wxyz, lengths meters, pixel centers at 0.5. The cameras of one capsule form a rig, whose
reference is the first of them; simultaneous images have equal names. Models have no times;
these are in an additional `times.txt`. Sources:
https://colmap.github.io/format.html, https://colmap.github.io/rigs.html.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import numpy as np

from vrcaps.camera.camera import Camera, in_image, pixel_grid, project_points, unproject_pixels
from vrcaps.camera.lens.exchange import (
    COLMAP_MODELS,
    HALF,
    OPENCV_LENSES,
    colmap_model,
    lens_from_colmap,
)
from vrcaps.core import rng
from vrcaps.core.errors import InputError
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.files import write_bytes
from vrcaps.core.geometry import (
    invert,
    matrix_from_unit_quaternion,
    quaternion_from_matrix,
    transform_from,
    transform_points,
)
from vrcaps.core.names import inside
from vrcaps.formats.format import Needs
from vrcaps.formats.shared.folders import find_folders, image_loader, rig_folders
from vrcaps.formats.shared.stored_images import read_rgb
from vrcaps.formats.shared.text_files import read_times, write_times
from vrcaps.recording.frame_files import write_images
from vrcaps.recording.frame_sequence import CAMERA_POSE, TIME, FrameSequence

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int, UInt8

    from vrcaps.formats.format import Advance

_CAMERAS, _IMAGES, _POINTS, _RIGS = "cameras.txt", "images.txt", "points3D.txt", "rigs.txt"
_MODEL = "sparse/0"


@dataclass(frozen=True)
class Colmap:
    """COLMAP text model with rigs: `images/`, `sparse/0/`.

    Attributes:
        points: Number of wall points sampled over all images; those visible in two or more images
            become points of the model. They need the channel depth; 0 writes none.
    """

    points: Annotated[int, Range(0)] = 10000

    kind: ClassVar[str] = "colmap"
    needs: ClassVar[Needs] = Needs(lenses=OPENCV_LENSES)

    def __post_init__(self) -> None:
        check_fields(self)

    def write(self, sequences: Sequence[FrameSequence], folder: Path, advance: Advance) -> None:
        """Write a model for each episode.

        Raises:
            InputError: If points are requested and there is no depth.
        """
        for sequence in sequences:
            if self.points > 0 and "depth" not in sequence.channels:
                raise InputError(
                    f"colmap requires the channel 'depth' for points; {sequence.name} lacks it. "
                    "Record it, or add --points 0."
                )
        for rig, root in rig_folders(sequences, folder):
            model = root / _MODEL
            model.mkdir(parents=True)
            points = seen_points(rig, self.points)
            write_bytes(model / _CAMERAS, _cameras_text(rig).encode())
            write_bytes(model / _RIGS, _rigs_text(rig).encode())
            write_bytes(model / "frames.txt", _frames_text(rig).encode())
            write_bytes(model / _POINTS, _points_text(points).encode())
            write_bytes(model / _IMAGES, _images_text(rig, points).encode())
            write_times(root, rig[0])
            for sequence, name in zip(rig, _prefixes(rig), strict=True):
                (root / "images" / name).mkdir(parents=True)
                for k in range(len(sequence)):
                    path = root / "images" / _image_name(name, k)
                    write_images([(path, sequence.image("rgb", k))])
                    advance()

    def read(self, folder: Path) -> tuple[FrameSequence, ...]:
        """Return a sequence for each camera of each model, with images sorted by name.

        Without `times.txt` the time of a frame is its index.

        Raises:
            InputError: If it is not in this layout.
        """
        return tuple(
            sequence
            for root, split in find_folders(folder, _CAMERAS)
            for sequence in _read_model(root, split)
        )


def _prefixes(rig: Sequence[FrameSequence]) -> list[str]:
    """Folder names of the cameras' images."""
    names = [None if one.camera is None else one.camera.name for one in rig]
    return [f"rig1/{name}" for name in names]


def _image_name(prefix: str, index: int) -> str:
    return f"{prefix}/image{index + 1:06d}.png"


def _image_id(rig: Sequence[FrameSequence], camera: int, index: int) -> int:
    """Image ID from 1: frame by frame, in each camera by camera."""
    return index * len(rig) + camera + 1


def _numbers(values: Sequence[float] | np.ndarray) -> str:
    return " ".join(f"{value:.15g}" for value in values)


def _pose(T_to_from: np.ndarray) -> str:
    """``QW QX QY QZ TX TY TZ`` of a transform."""
    return f"{_numbers(quaternion_from_matrix(T_to_from[:3, :3]))} {_numbers(T_to_from[:3, 3])}"


def _cameras_text(rig: Sequence[FrameSequence]) -> str:
    lines = ["# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]"]
    for number, sequence in enumerate(rig, 1):
        assert sequence.camera is not None
        model, parameters = colmap_model(sequence.camera.lens, sequence.name)
        size = f"{sequence.camera.width} {sequence.camera.height}"
        lines.append(f"{number} {model} {size} {_numbers([*parameters.values()])}")
    return "\n".join(lines) + "\n"


def _rigs_text(rig: Sequence[FrameSequence]) -> str:
    """Text of one rig; poses of its cameras are reference to camera."""
    words = [f"1 {len(rig)} CAMERA 1"]
    for number, sequence in enumerate(rig[1:], 2):
        T_camera_reference = invert(sequence.Ts_world_camera[0]) @ rig[0].Ts_world_camera[0]
        words.append(f"CAMERA {number} 1 {_pose(T_camera_reference)}")
    header = "# RIG_ID, NUM_SENSORS, REF_SENSOR_TYPE, REF_SENSOR_ID, SENSORS[] as "
    return f"{header}(SENSOR_TYPE, SENSOR_ID, HAS_POSE, [POSE])\n{' '.join(words)}\n"


def _frames_text(rig: Sequence[FrameSequence]) -> str:
    lines = ["# FRAME_ID, RIG_ID, RIG_FROM_WORLD[], NUM_DATA_IDS, DATA_IDS[]"]
    for k, T_world_rig in enumerate(rig[0].Ts_world_camera):
        data = [f"CAMERA {c + 1} {_image_id(rig, c, k)}" for c in range(len(rig))]
        lines.append(f"{k + 1} 1 {_pose(invert(T_world_rig))} {len(rig)} {' '.join(data)}")
    return "\n".join(lines) + "\n"


def _images_text(rig: Sequence[FrameSequence], points: SeenPoints) -> str:
    lines = ["# IMAGE_ID, POSE[] world to camera, CAMERA_ID, NAME", "# (X, Y, POINT3D_ID)[]"]
    prefixes = _prefixes(rig)
    for k in range(len(rig[0])):
        for c, sequence in enumerate(rig):
            pose = _pose(invert(sequence.Ts_world_camera[k]))
            image_id = _image_id(rig, c, k)
            lines.append(f"{image_id} {pose} {c + 1} {_image_name(prefixes[c], k)}")
            indices, pixels = points.seen[c][k]
            rows = zip(indices + 1, pixels + HALF, strict=True)
            lines.append(" ".join(f"{x:.4f} {y:.4f} {point}" for point, (x, y) in rows))
    return "\n".join(lines) + "\n"


def _points_text(points: SeenPoints) -> str:
    """Text of points with their tracks: image ID, and index in the image's list of points."""
    tracks: list[list[str]] = [[] for _ in points.positions]
    num_cameras = len(points.seen)
    for c, frames in enumerate(points.seen):
        for k, (indices, _) in enumerate(frames):
            for index, point in enumerate(indices):
                tracks[point].append(f"{k * num_cameras + c + 1} {index}")
    lines = ["# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)"]
    for number, track in enumerate(tracks):
        color = " ".join(map(str, points.colors[number]))
        position = _numbers(points.positions[number])
        lines.append(f"{number + 1} {position} {color} 0 {' '.join(track)}")
    return "\n".join(lines) + "\n"


def _read_model(model: Path, split: str | None) -> list[FrameSequence]:
    cameras = {int(row[0]): row for row in _rows(model / _CAMERAS)}
    mounts = _read_mounts(model / _RIGS)
    root = _image_root(model)
    rows = _rows(model / _IMAGES, every=2)
    sequences = []
    for number, row in cameras.items():
        mine = sorted((each for each in rows if int(each[8]) == number), key=lambda each: each[9])
        if not mine:
            continue
        names = [" ".join(each[9:]) for each in mine]
        folder = Path(names[0]).parent
        name = folder.name if folder.parts[:1] == ("rig1",) else f"camera{number}"
        camera = _read_camera(row, name, model).at(mounts.get(number, np.eye(4)))
        poses = np.array([each[1:8] for each in mine], float)
        rotations = matrix_from_unit_quaternion(poses[:, :4], model / _IMAGES)
        Ts_camera_world = transform_from(rotations, poses[:, 4:])
        times = read_times(root, range(len(mine)), 1.0)
        values = {TIME: times, CAMERA_POSE: invert(Ts_camera_world)}
        load = image_loader(
            {"rgb": [inside(root, f"images/{each}") for each in names]}, {"rgb": read_rgb}
        )
        sequences.append(
            FrameSequence(f"{root.name}/{name}", ("rgb",), values, load, camera, split=split)
        )
    return sequences


def _image_root(model: Path) -> Path:
    """Image folder of the scene of a model."""
    for root in (model.parent.parent, model.parent, model):
        if (root / "images").is_dir():
            return root
    raise InputError(f"There is no folder images next to {model} or above it.")


def _rows(path: Path, every: int = 1) -> list[list[str]]:
    """Words of the lines without comments; of every second one if `every` is 2."""
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, ValueError) as error:
        raise InputError(f"Cannot read {path}: {error}.") from error
    rows = [line.split() for line in lines if not line.startswith("#")]
    rows = rows[::every] if every > 1 else [row for row in rows if row]
    min_words = {_CAMERAS: 5, _IMAGES: 10}.get(path.name, 4)
    for row in (row for row in rows if row):
        if len(row) < min_words:
            raise InputError(f"{path} has a row of {len(row)} words: {' '.join(row)!r}.")
    return [row for row in rows if row]


def _read_camera(row: list[str], name: str, model: Path) -> Camera:
    parameters = dict(zip(COLMAP_MODELS.get(row[1], ()), map(float, row[4:]), strict=False))
    lens = lens_from_colmap(row[1], parameters, str(model / _CAMERAS))
    return Camera(name, lens, int(row[2]), int(row[3]))


def _read_mounts(path: Path) -> dict[int, np.ndarray]:
    """Pose of each camera in its rig [m], if there are rigs; the reference has none."""
    mounts: dict[int, np.ndarray] = {}
    for row in _rows(path) if path.exists() else []:
        words = row[4:]
        while len(words) >= 3:
            has_pose = words[2] == "1"
            if has_pose:
                pose = np.array(words[3:10], float)
                rotation = matrix_from_unit_quaternion(pose[:4], path)
                T_camera_rig = transform_from(rotation, pose[4:])
                mounts[int(words[1])] = invert(T_camera_rig)
            words = words[10 if has_pose else 3 :]
    return mounts


_SLACK, _STEP = 1e-3, 2e-5
"""Tolerance of a visible point's depth from the surrounding pixels: a fraction, and [m]."""


@dataclass(frozen=True)
class SeenPoints:
    """Points of the wall with their observations.

    Attributes:
        positions: In the world frame [m].
        colors: sRGB of the pixel that each was sampled at.
        seen: Indices [m] of the points and their pixels [m 2], for each camera and frame.
    """

    positions: Float[np.ndarray, "n 3"]
    colors: UInt8[np.ndarray, "n 3"]
    seen: list[list[tuple[Int[np.ndarray, " m"], Float[np.ndarray, "m 2"]]]]


def seen_points(sequences: Sequence[FrameSequence], count: int) -> SeenPoints:
    """Sample points at pixels of all images and keep those visible in two or more images.

    A point is visible if its z lies within the depths of the four surrounding pixels.

    Args:
        sequences: Cameras of one capsule, with rgb and depth unless `count` is 0.
        count: Number of sampled points; most are seen twice if the capsule moves slowly.
    """
    images = sum(map(len, sequences))
    samples = [
        _drawn(sequence, k, -(-count // images))
        for sequence in sequences
        for k in range(len(sequence) if count > 0 else 0)
    ]
    positions = np.concatenate([np.zeros((0, 3)), *(points for points, _ in samples)])
    colors = np.concatenate([np.zeros((0, 3), np.uint8), *(color for _, color in samples)])
    if count == 0:
        nothing = np.zeros(0, int), np.zeros((0, 2))
        return SeenPoints(positions, colors, [[nothing] * len(one) for one in sequences])
    seen = [[_seen(one, k, positions) for k in range(len(one))] for one in sequences]
    everywhere = np.concatenate([each for row in seen for each, _ in row])
    kept = np.bincount(everywhere, minlength=len(positions)) >= 2
    indices = np.cumsum(kept) - 1
    tracks = [[(indices[each[kept[each]]], at[kept[each]]) for each, at in row] for row in seen]
    return SeenPoints(positions[kept], colors[kept], tracks)


def _drawn(sequence: FrameSequence, index: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Points [m] and colors of pixels sampled from an image."""
    camera = _camera(sequence)
    depth, rgb = sequence.image("depth", index), sequence.image("rgb", index)
    rows, columns = np.nonzero(depth > 0.0)
    draw = rng.stream(0, f"formats/seen_points/{camera.name}/{index}")
    chosen = draw.permutation(len(rows))[:count]
    rows, columns = rows[chosen], columns[chosen]
    rays = unproject_pixels(camera, pixel_grid(camera.width, camera.height)[rows, columns])
    points = rays * (depth[rows, columns] / rays[:, 2])[:, None]
    return transform_points(sequence.Ts_world_camera[index], points), rgb[rows, columns]


def _seen(
    sequence: FrameSequence, index: int, positions: Float[np.ndarray, "n 3"]
) -> tuple[Int[np.ndarray, " m"], Float[np.ndarray, "m 2"]]:
    camera = _camera(sequence)
    points = transform_points(invert(sequence.Ts_world_camera[index]), positions)
    pixels = project_points(camera, points)
    inside = np.flatnonzero(in_image(camera, pixels) & (points[:, 2] > 0.0))
    near = _is_at_depth(sequence.image("depth", index), pixels[inside], points[inside, 2])
    visible = inside[near]
    return visible, pixels[visible]


def _is_at_depth(
    depth: Float[np.ndarray, "h w"], pixels: Float[np.ndarray, "n 2"], z: Float[np.ndarray, " n"]
) -> Bool[np.ndarray, " n"]:
    """Return whether z lies within the depths of the four pixels around each position."""
    height, width = depth.shape
    corners = []
    for step in (np.floor, np.ceil):
        for other in (np.floor, np.ceil):
            column = step(pixels[:, 0]).astype(int).clip(0, width - 1)
            row = other(pixels[:, 1]).astype(int).clip(0, height - 1)
            corners.append(depth[row, column])
    known = np.isfinite(corners)
    nearest = np.where(known, corners, np.inf).min(axis=0)
    farthest = np.where(known, corners, -np.inf).max(axis=0)
    slack = _SLACK * z + _STEP
    return (z >= nearest - slack) & (z <= farthest + slack)


def _camera(sequence: FrameSequence) -> Camera:
    assert sequence.camera is not None
    return sequence.camera
