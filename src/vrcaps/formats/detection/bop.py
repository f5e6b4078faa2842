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

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np

from vrcaps.camera.lens import LensPinhole
from vrcaps.config.limits import Range, check_fields
from vrcaps.core.errors import InputError
from vrcaps.core.files import write_bytes, write_json
from vrcaps.core.transforms import invert
from vrcaps.core.units import MM
from vrcaps.formats.detection.lesion_models import LesionModel, lesion_models
from vrcaps.formats.detection.read_bop import SCENE_CAMERA, SCENE_GT, read_bop
from vrcaps.formats.format import Needs
from vrcaps.formats.shared.folders import write_names
from vrcaps.formats.shared.frame_files import write_times
from vrcaps.formats.shared.intrinsics import matrix_of, plain_pinhole
from vrcaps.formats.shared.stored_images import stored_steps
from vrcaps.recording.frame_files import write_images
from vrcaps.recording.organ_files import organ_name

if TYPE_CHECKING:
    from jaxtyping import Bool, Float
    from numpy.typing import NDArray

    from vrcaps.formats.format import Advance
    from vrcaps.recording.frame_sequence import FrameSequence

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
            place = folder / split / f"{scene:06d}"
            models = _models(sequence, known)
            infos = self._write_scene(place, sequence, models, advance)
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
        return read_bop(folder)

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
        write_json(place / SCENE_CAMERA, cameras)
        write_json(place / SCENE_GT, truths)
        write_json(place / "scene_gt_info.json", infos)
        write_times(place, sequence)
        return {
            key: [(t["obj_id"], i["visib_fract"]) for t, i in zip(rows, infos[key], strict=True)]
            for key, rows in truths.items()
        }


@dataclass(frozen=True)
class _Seen:
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
        write_bytes(folder / f"obj_{model.number:06d}.ply", model.ply())
        infos[str(model.number)] = model.info()
    write_json(folder / "models_info.json", infos)


def _matrix(sequence: FrameSequence) -> Float[np.ndarray, "3 3"]:
    assert sequence.camera is not None
    assert isinstance(sequence.camera.lens, LensPinhole)
    return matrix_of(sequence.camera.lens)


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
) -> Sequence[_Seen]:
    """Lesions whose silhouette lies in an image, including occluded ones."""
    episode = sequence.episode
    assert episode is not None
    T_world_patient = np.array(episode.head["T_world_patient"])
    T_camera_patient = invert(sequence.Ts_world_camera[index]) @ T_world_patient
    instance = sequence.image("instance", index)
    found = []
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
            "obj_id": model.number,
            "instance": number,
        }
        found.append(_Seen(mask, visible, truth, _info(part, mask, visible, depth)))
    return found


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


def _require_rigid(sequence: FrameSequence, number: int, beside: NDArray) -> None:
    off = float(np.nanmedian(np.abs(beside))) if np.isfinite(beside).any() else 0.0
    if off > _SAME_WALL:
        raise InputError(
            f"Lesion {number} of {sequence.name} lies {off / MM:.2g} mm beside its place at rest: "
            "the wall moves, and bop holds rigid objects. Export a recording of a wall at rest."
        )


def _info(
    part: tuple[tuple[int, int], NDArray], mask: NDArray, visible: NDArray, depth: NDArray
) -> dict[str, Any]:
    """Row of `scene_gt_info.json`."""
    (first_column, first_row), whole = part
    rows, columns = np.nonzero(np.isfinite(whole))
    all_px, seen_px = len(rows), int(visible.sum())
    shown = np.nonzero(visible)
    return {
        "bbox_obj": _box(rows + first_row, columns + first_column),
        "bbox_visib": _box(*shown) if seen_px else [-1, -1, -1, -1],
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
        for number, share in rows
        if share >= 0.1
    ]
