"""Reader of photographs from files, folders and videos."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import InputError, reading
from vrcaps.core.files import file_sha256
from vrcaps.core.names import listed
from vrcaps.formats.shared.stored_images import read_rgb

if TYPE_CHECKING:
    from jaxtyping import UInt8

IMAGES = (".bmp", ".jpeg", ".jpg", ".png", ".tif", ".tiff", ".webp")
"""File name extensions of images."""

VIDEOS = (".avi", ".m4v", ".mkv", ".mov", ".mp4", ".mpeg", ".mpg", ".webm")
"""File name extensions of videos."""


@dataclass(frozen=True)
class Photo:
    """Endoscopic image.

    Attributes:
        name: File name; for a video, with the frame index.
        rgb: sRGB values.
        sha256: Checksum of the file.
    """

    name: str
    rgb: UInt8[np.ndarray, "h w 3"]
    sha256: str = ""


def read_photos(paths: Sequence[Path], *, num_frames: int = 8) -> list[Photo]:
    """Read all images of files and folders, sorted by name within a folder.

    Args:
        paths: Images, videos, or folders of them (without their subfolders).
        num_frames: Frames to read from each video, evenly spaced.

    Raises:
        InputError: If a path is missing, contains no image, or cannot be read as one.
    """
    if num_frames < 1:
        raise InputError(f"The number of frames of a video is {num_frames}. Allowed: 1 or more.")
    photos = [photo for path in paths for file in _files(path) for photo in _read(file, num_frames)]
    if not photos:
        raise InputError("No photograph is given. Give pictures, videos or folders of them.")
    return photos


def _files(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]
    known = IMAGES + VIDEOS
    files = [file for file in listed(path, "*") if file.suffix.lower() in known]
    if not files:
        raise InputError(f"Folder {path} contains no photograph. Allowed: {', '.join(known)}.")
    return files


def _read(path: Path, num_frames: int) -> list[Photo]:
    if not path.is_file():
        raise InputError(f"No file at {path}. Give pictures, videos or folders of them.")
    if path.suffix.lower() in VIDEOS:
        return _read_video(path, num_frames)
    if path.suffix.lower() not in IMAGES:
        raise InputError(f"{path} is not a picture. Allowed: {', '.join(IMAGES + VIDEOS)}.")
    return [Photo(path.name, read_rgb(path), file_sha256(path))]


def _read_video(path: Path, num_frames: int) -> list[Photo]:
    import av

    with reading(f"the video {path}"):
        with av.open(str(path)) as container:
            total = sum(1 for _ in container.decode(video=0))
        wanted = set(np.unique(np.linspace(0, total - 1, num_frames).astype(int)).tolist())
        with av.open(str(path)) as container:
            frames = [
                (index, frame.to_ndarray(format="rgb24"))
                for index, frame in enumerate(container.decode(video=0))
                if index in wanted
            ]
    if not frames:
        raise InputError(f"The video {path} has no frame. Give another.")
    digest = file_sha256(path)
    return [Photo(f"{path.name}, frame {index}", rgb, digest) for index, rgb in frames]
