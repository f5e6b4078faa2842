"""BOP: lesions as objects with models and 6D poses, in the layout of the pose benchmark.

Models are the patches of the wall covered by lesions, in `models/`, ASCII PLY in millimeters. Each
sequence is a scene `<split>/000000/` (`train` if there are no splits). `cam_R_w2c`, `cam_t_w2c`
are world to camera, `cam_R_m2c`, `cam_t_m2c` model to camera, millimeters; pixel (0, 0) is the
center of the top-left pixel. Depth is a 16-bit PNG of z in steps of `depth_scale` millimeters, 0
without a value. `mask/` is the whole silhouette in the image, `mask_visib/` its visible part;
`px_count_all` and `bbox_obj` refer to a canvas of three times the image's sides. Boxes are x,
y and the differences between the last and the first pixel. Source:
https://github.com/thodan/bop_toolkit/blob/master/docs/bop_datasets_format.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np

from vrcaps.camera.lens import LensPinhole
from vrcaps.camera.lens.exchange import camera_matrix
from vrcaps.config.plain_files import read_plain
from vrcaps.core.errors import InputError, narrow
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.files import write_bytes, write_json
from vrcaps.core.geometry import invert, transform_from
from vrcaps.core.units import MM
from vrcaps.formats.detection.lesion_models import LesionModel, lesion_models
from vrcaps.formats.format import Needs
from vrcaps.formats.shared.folders import (
    by_number,
    find_folders,
    images_in,
    matched,
    with_names,
    write_names,
)
from vrcaps.formats.shared.stored_images import read_plane, read_rgb, stored_steps
from vrcaps.formats.shared.text_files import camera_of, plain_pinhole, read_times, write_times
from vrcaps.recording.frame_files import write_images
from vrcaps.recording.frame_sequence import CAMERA_POSE, TIME, FrameSequence
from vrcaps.recording.layout import organ_name

if TYPE_CHECKING:
    from jaxtyping import Bool, Float
    from numpy.typing import NDArray

    from vrcaps.formats.format import Advance

_CAMERA, _TRUTH = "scene_camera.json", "scene_gt.json"
_SAME_WALL = 0.2 * MM
"""Maximum median distance between a lesion's surface and its model over its pixels."""

Models = Mapping[int, LesionModel]
Rows = list[dict[str, Any]]


@dataclass(frozen=True)
class Bop:
    """BOP: `models/`, scenes with `scene_camera.json`, `scene_gt.json`, masks.

    Attributes:
        depth_step_mm: Step of the stored depth; the maximum depth is 65,535 steps.
    """

    depth_step_mm: Annotated[float, Range(above=0.0)] = 0.01

    kind: ClassVar[str] = "bop"
    needs: ClassVar[Needs] = Needs(("rgb", "depth", "instance"), ("pinhole",), episode=True)

    def __post_init__(self) -> None:
        check_fields(self)

    def write(self, sequences: Sequence[FrameSequence], folder: Path, advance: Advance) -> None:
        """Write the models of all lesions and a scene for each sequence.

        Raises:
            InputError: If a lens has distortion, or a wall moves, so that lesions are not rigid.
        """
        known: dict[str, Models] = {}
        targets: Rows = []
        names: dict[str, FrameSequence] = {}
        for sequence in sequences:
            plain_pinhole(self, sequence)
            split = sequence.split or "train"
            scene = sum(name.startswith(f"{split}/") for name in names)
            scene_folder = folder / split / f"{scene:06d}"
            models = _models(sequence, known)
            infos = self._write_scene(scene_folder, sequence, models, advance)
            names[f"{split}/{scene:06d}"] = sequence
            if split == "test":
                targets += _targets(infos, scene)
        _write_models(folder / "models", known)
        write_names(folder, names)
        if targets:
            write_json(folder / "test_targets_bop19.json", targets)

    def read(self, folder: Path) -> tuple[FrameSequence, ...]:
        """Return the scenes of a folder; `instance` is the visible part of each object.

        Raises:
            InputError: If it is not in this layout.
        """
        return with_names(
            folder,
            (
                (place.relative_to(folder).as_posix(), _read_scene(place, split))
                for place, split in find_folders(folder, _CAMERA)
            ),
        )

    def _write_scene(
        self, place: Path, sequence: FrameSequence, models: Models, advance: Advance
    ) -> dict[str, list[tuple[int, float]]]:
        """Write a scene; return objects and visible fractions for each image."""
        for name in ("rgb", "depth", "mask", "mask_visib"):
            (place / name).mkdir(parents=True)
        cameras: dict[str, Any] = {}
        truths: dict[str, Rows] = {}
        infos: dict[str, Rows] = {}
        for k in range(len(sequence)):
            depth = sequence.image("depth", k)
            stored = stored_steps(depth / MM / self.depth_step_mm)
            images = [
                (place / f"rgb/{k:06d}.png", sequence.image("rgb", k)),
                (place / f"depth/{k:06d}.png", stored),
            ]
            cameras[str(k)] = _camera_row(sequence, k, self.depth_step_mm)
            truths[str(k)], infos[str(k)] = [], []
            for seen in _seen_lesions(sequence, k, models, depth):
                name = f"{k:06d}_{len(truths[str(k)]):06d}.png"
                images.append((place / "mask" / name, _bytes(seen.mask)))
                images.append((place / "mask_visib" / name, _bytes(seen.visible)))
                truths[str(k)].append(seen.truth)
                infos[str(k)].append(seen.info)
            write_images(images)
            advance()
        write_json(place / _CAMERA, cameras)
        write_json(place / _TRUTH, truths)
        write_json(place / "scene_gt_info.json", infos)
        write_times(place, sequence)
        return {
            key: [(t["obj_id"], i["visib_fract"]) for t, i in zip(rows, infos[key], strict=True)]
            for key, rows in truths.items()
        }


@dataclass(frozen=True)
class _LesionView:
    """Lesion in an image: its masks, and its rows of `scene_gt` and `scene_gt_info`."""

    mask: Bool[np.ndarray, "h w"]
    visible: Bool[np.ndarray, "h w"]
    truth: dict[str, Any]
    info: dict[str, Any]


def _models(sequence: FrameSequence, known: dict[str, Models]) -> Models:
    """Models of a sequence's lesions; episodes with the same organ share them."""
    episode = sequence.episode
    assert episode is not None
    name = organ_name(episode.head)
    key = name if name.startswith("..") else episode.url
    if key not in known:
        known[key] = lesion_models(episode, 1 + sum(map(len, known.values())))
    return known[key]


def _write_models(folder: Path, known: dict[str, Models]) -> None:
    folder.mkdir()
    infos = {}
    for model in (each for models in known.values() for each in models.values()):
        write_bytes(folder / f"obj_{model.object_id:06d}.ply", model.ply())
        infos[str(model.object_id)] = model.info()
    write_json(folder / "models_info.json", infos)


def _matrix(sequence: FrameSequence) -> Float[np.ndarray, "3 3"]:
    assert sequence.camera is not None
    return camera_matrix(sequence.camera.lens)


def _camera_row(sequence: FrameSequence, index: int, step_mm: float) -> dict[str, Any]:
    T_camera_world = invert(sequence.Ts_world_camera[index])
    return {
        "cam_K": _matrix(sequence).ravel().tolist(),
        "depth_scale": step_mm,
        "cam_R_w2c": T_camera_world[:3, :3].ravel().tolist(),
        "cam_t_w2c": (T_camera_world[:3, 3] / MM).tolist(),
    }


def _seen_lesions(
    sequence: FrameSequence, index: int, models: Models, depth: NDArray
) -> Sequence[_LesionView]:
    """Lesions whose silhouette lies in an image, including occluded ones."""
    episode = sequence.episode
    assert episode is not None
    T_world_patient = np.array(episode.head["T_world_patient"])
    T_camera_patient = invert(sequence.Ts_world_camera[index]) @ T_world_patient
    instance = sequence.image("instance", index)
    lesions = []
    for number, model in models.items():
        T_camera_model = T_camera_patient @ model.T_patient_model
        height, width = depth.shape
        canvas = (-width, -height, 2 * width - 1, 2 * height - 1)
        part = model.depth(T_camera_model, _matrix(sequence), canvas)
        if part is None:
            continue
        alone = _in_image(part, depth.shape)
        mask = np.isfinite(alone)
        if not mask.any():
            continue
        visible = mask & (instance == number)
        _require_rigid(sequence, number, (alone - depth)[visible])
        truth = {
            "cam_R_m2c": T_camera_model[:3, :3].ravel().tolist(),
            "cam_t_m2c": (T_camera_model[:3, 3] / MM).tolist(),
            "obj_id": model.object_id,
            "instance": number,
        }
        lesions.append(_LesionView(mask, visible, truth, _info(part, mask, visible, depth)))
    return lesions


def _in_image(
    part: tuple[tuple[int, int], NDArray], shape: tuple[int, int]
) -> Float[np.ndarray, "h w"]:
    """Part of a canvas crop that lies in the image; NaN elsewhere."""
    (column, row), values = part
    image = np.full(shape, np.nan)
    low = max(row, 0), max(column, 0)
    high = min(row + values.shape[0], shape[0]), min(column + values.shape[1], shape[1])
    if low[0] < high[0] and low[1] < high[1]:
        own = values[low[0] - row : high[0] - row, low[1] - column : high[1] - column]
        image[low[0] : high[0], low[1] : high[1]] = own
    return image


def _require_rigid(sequence: FrameSequence, lesion_id: int, offset: NDArray) -> None:
    distance = float(np.nanmedian(np.abs(offset))) if np.isfinite(offset).any() else 0.0
    if distance > _SAME_WALL:
        raise InputError(
            f"Lesion {lesion_id} of {sequence.name} is {distance / MM:.2g} mm from its position at "
            "rest, because the wall moves. Allowed for bop: recordings of a wall at rest."
        )


def _info(
    part: tuple[tuple[int, int], NDArray], mask: NDArray, visible: NDArray, depth: NDArray
) -> dict[str, Any]:
    """Row of `scene_gt_info.json`."""
    (first_column, first_row), whole = part
    rows, columns = np.nonzero(np.isfinite(whole))
    all_px, seen_px = len(rows), int(visible.sum())
    pixels = np.nonzero(visible)
    return {
        "bbox_obj": _box(rows + first_row, columns + first_column),
        "bbox_visib": _box(*pixels) if seen_px else [-1, -1, -1, -1],
        "px_count_all": all_px,
        "px_count_valid": int(np.isfinite(depth[mask]).sum()),
        "px_count_visib": seen_px,
        "visib_fract": seen_px / all_px,
    }


def _box(rows: NDArray, columns: NDArray) -> list[int]:
    x, y = int(columns.min()), int(rows.min())
    return [x, y, int(columns.max()) - x, int(rows.max()) - y]


def _bytes(mask: NDArray) -> NDArray:
    return np.where(mask, np.uint8(255), np.uint8(0))


def _targets(infos: dict[str, list[tuple[int, float]]], scene: int) -> Rows:
    """Objects to detect: those with a visible fraction of at least 10 %."""
    return [
        {"im_id": int(key), "inst_count": 1, "obj_id": number, "scene_id": scene}
        for key, rows in infos.items()
        for number, fraction in rows
        if fraction >= 0.1
    ]


def _read_scene(place: Path, split: str | None) -> FrameSequence:
    cameras = read_plain(place / _CAMERA, "camera")
    truths = read_plain(place / _TRUTH, "pose") if (place / _TRUTH).exists() else {}
    color = next((place / name for name in ("rgb", "gray") if (place / name).is_dir()), None)
    if color is None:
        raise InputError(f"{place} has no folder rgb, so it is not a BOP scene.")
    channels = {"rgb": by_number(images_in(color))}
    if (place / "depth").is_dir():
        channels["depth"] = by_number(images_in(place / "depth"))
    image_ids = list(channels["rgb"])
    paths = matched(channels)
    try:
        rows = [cameras[str(image_id)] for image_id in image_ids]
        fx, skew, cx, _, fy, cy, *_ = rows[0]["cam_K"]
        lens = LensPinhole(fx=fx, fy=fy, cx=cx, cy=cy, skew=skew)
        values = {TIME: read_times(place, image_ids, 1.0)}
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
            truth = [truths.get(str(image_id), []) for image_id in image_ids]
            readers["instance"] = partial(_read_instance, place / "mask_visib", paths["rgb"], truth)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{place / _CAMERA} is not a BOP file: {error} is missing.") from error
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
    for k, row in enumerate(truths[index]):
        mask = read_plane(masks / f"{images[index].stem}_{k:06d}.png")
        instance_id = row.get("instance", k + 1)
        instance[mask > 0] = narrow([instance_id], np.uint16, f"instance IDs in {masks.parent}")
    return instance
