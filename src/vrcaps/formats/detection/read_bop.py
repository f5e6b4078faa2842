"""Reader of BOP scenes from any source."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.camera.lens import LensPinhole
from vrcaps.config.plain_files import read_plain
from vrcaps.core.errors import InputError, narrow
from vrcaps.core.transforms import invert, transform_from
from vrcaps.core.units import MM
from vrcaps.formats.shared.folders import found_folders, with_names
from vrcaps.formats.shared.frame_files import by_number, images_in, matched, read_times
from vrcaps.formats.shared.intrinsics import camera_of
from vrcaps.formats.shared.stored_images import read_plane, read_rgb
from vrcaps.recording.frame_sequence import CAMERA_POSE, TIME, FrameSequence

if TYPE_CHECKING:
    from numpy.typing import NDArray

SCENE_CAMERA, SCENE_GT = "scene_camera.json", "scene_gt.json"


def read_bop(folder: Path) -> tuple[FrameSequence, ...]:
    """Return the scenes of a folder, see `Bop.read`.

    Raises:
        InputError: If it is not in this layout.
    """
    return with_names(
        folder,
        (
            (place.relative_to(folder).as_posix(), _read_scene(place, split))
            for place, split in found_folders(folder, SCENE_CAMERA)
        ),
    )


def _read_scene(place: Path, split: str | None) -> FrameSequence:
    cameras = read_plain(place / SCENE_CAMERA, "camera")
    truths = read_plain(place / SCENE_GT, "pose") if (place / SCENE_GT).exists() else {}
    color = next((place / name for name in ("rgb", "gray") if (place / name).is_dir()), None)
    if color is None:
        raise InputError(f"{place} has no folder rgb, so it is no scene of BOP.")
    channels = {"rgb": by_number(images_in(color))}
    if (place / "depth").is_dir():
        channels["depth"] = by_number(images_in(place / "depth"))
    numbers = list(channels["rgb"])
    paths = matched(channels)
    try:
        rows = [cameras[str(number)] for number in numbers]
        fx, skew, cx, _, fy, cy, *_ = rows[0]["cam_K"]
        lens = LensPinhole(fx=fx, fy=fy, cx=cx, cy=cy, skew=skew)
        values = {TIME: read_times(place, numbers, 1.0)}
        if all("cam_R_w2c" in row for row in rows):
            rotation = np.array([row["cam_R_w2c"] for row in rows]).reshape(-1, 3, 3)
            translation = np.array([row["cam_t_w2c"] for row in rows]) * MM
            values[CAMERA_POSE] = invert(transform_from(rotation, translation))
        scales = [float(row.get("depth_scale", 1.0)) for row in rows]
        readers: dict[str, Callable[[int], NDArray]] = {
            "rgb": partial(_read_color, paths["rgb"]),
            **({"depth": partial(_read_depth, paths["depth"], scales)} if "depth" in paths else {}),
        }
        if truths:
            truth = [truths.get(str(number), []) for number in numbers]
            readers["instance"] = partial(_read_instance, place / "mask_visib", paths["rgb"], truth)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{place / SCENE_CAMERA} is not as BOP's: {error} is missing.") from error
    camera = camera_of(lens, paths["rgb"][0])
    load = partial(_load, readers)
    name = "/".join(place.parts[-2:])
    return FrameSequence(name, tuple(readers), values, load, camera, split=split)


def _load(readers: Mapping[str, Callable[[int], NDArray]], channel: str, index: int) -> NDArray:
    return readers[channel](index)


def _read_color(paths: list[Path], index: int) -> NDArray:
    return read_rgb(paths[index])


def _read_depth(paths: list[Path], scales: list[float], index: int) -> NDArray:
    stored = read_plane(paths[index])
    return np.where(stored > 0, stored * (scales[index] * MM), np.nan).astype(np.float32)


def _read_instance(
    masks: Path, images: list[Path], truths: list[list[dict[str, Any]]], index: int
) -> NDArray:
    """Visible object IDs per pixel: of the lesion, or the index in the image's list."""
    instance = np.zeros(read_rgb(images[index]).shape[:2], np.uint16)
    for place, row in enumerate(truths[index]):
        mask = read_plane(masks / f"{images[index].stem}_{place:06d}.png")
        number = row.get("instance", place + 1)
        instance[mask > 0] = narrow([number], np.uint16, f"instance numbers in {masks.parent}")
    return instance
