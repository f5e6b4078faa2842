"""nerfstudio: `transforms.json` with images, depths and masks, for radiance fields and splatting.

`transform_matrix` is camera to world [m] with OpenGL's camera axes: x right, y up, z backward.
Pixel centers are at 0.5. Depths are `.npy` files of float32 in millimeters, because the loader
reads PNG in integer millimeters; 0 means no value. The loader multiplies depth by the length of its
ray directions, which have z = 1 for pinholes and length 1 for fisheyes: the file of a
pinhole therefore holds z, that of a fisheye the distance along the ray. Source:
https://docs.nerf.studio/quickstart/data_conventions.html.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from vrcaps.camera.camera import Camera, camera_rays
from vrcaps.camera.lens.exchange import OPENCV_LENSES, colmap_model, lens_from_colmap
from vrcaps.config.plain_files import read_plain
from vrcaps.core.errors import InputError
from vrcaps.core.files import write_json
from vrcaps.core.names import inside
from vrcaps.core.units import MM
from vrcaps.formats.format import Needs
from vrcaps.formats.shared.folders import find_folders, image_loader, rig_folders
from vrcaps.formats.shared.stored_images import read_numbers, read_rgb
from vrcaps.formats.shared.text_files import read_times, write_times
from vrcaps.recording.frame_files import write_images
from vrcaps.recording.frame_sequence import CAMERA_POSE, TIME, FrameSequence

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy.typing import NDArray

    from vrcaps.formats.format import Advance

_FILE = "transforms.json"
_R_CAMERA_GL = np.diag([1.0, -1.0, -1.0, 1.0])
_LENS_KEYS = ("fl_x", "fl_y", "cx", "cy", "w", "h", "k1", "k2", "k3", "k4", "p1", "p2")


@dataclass(frozen=True)
class Nerfstudio:
    """nerfstudio: `transforms.json`, `images/`, `depths/`, `masks/`."""

    kind: ClassVar[str] = "nerfstudio"
    needs: ClassVar[Needs] = Needs(lenses=OPENCV_LENSES)

    def write(self, sequences: Sequence[FrameSequence], folder: Path, advance: Advance) -> None:
        """Write a folder for each episode, with all its cameras.

        Raises:
            InputError: If its cameras have different models, which one file cannot hold.
        """
        for rig, root in rig_folders(sequences, folder):
            models = {_model(sequence) for sequence in rig}
            if len(models) > 1:
                raise InputError(
                    f"nerfstudio holds one camera model; those of {root.name} are "
                    f"{' and '.join(sorted(models))}. Add --camera NAME to export one of them."
                )
            lenses = [_lens_values(sequence) for sequence in rig]
            has_masks = any(np.isnan(_rays(sequence)).any() for sequence in rig)
            frames: list[dict[str, Any]] = []
            for sequence, lens in zip(rig, lenses, strict=True):
                mask = _write_mask(root, sequence) if has_masks else {}
                own = lens if len(lenses) > 1 else {}
                for k in range(len(sequence)):
                    frames.append({**_write_frame(root, sequence, k), **mask, **own})
                    advance()
            shared = lenses[0] if len(lenses) == 1 else {}
            write_json(root / _FILE, {"camera_model": models.pop(), **shared, "frames": frames})
            write_times(root, rig[0])

    def read(self, folder: Path) -> tuple[FrameSequence, ...]:
        """Return a sequence for each folder of images, in the order of the file.

        Without `times.txt` the time of a frame is its index.

        Raises:
            InputError: If it is not in this layout.
        """
        return tuple(
            sequence
            for root, split in find_folders(folder, _FILE)
            for sequence in _read_file(root, split)
        )


def _camera(sequence: FrameSequence) -> Camera:
    assert sequence.camera is not None
    return sequence.camera


def _rays(sequence: FrameSequence) -> Float[np.ndarray, "h w 3"]:
    return camera_rays(_camera(sequence))


def _model(sequence: FrameSequence) -> str:
    return "OPENCV" if _camera(sequence).lens.kind == "pinhole" else "OPENCV_FISHEYE"


def _lens_values(sequence: FrameSequence) -> dict[str, float]:
    """Lens and size of the images, by the keys of the file."""
    camera = _camera(sequence)
    _, values = colmap_model(camera.lens, sequence.name)
    named = {"fl_x": values.pop("fx"), "fl_y": values.pop("fy"), **values}
    return {key: named.get(key, 0.0) for key in _LENS_KEYS} | {
        "w": camera.width,
        "h": camera.height,
    }


def _write_frame(root: Path, sequence: FrameSequence, index: int) -> dict[str, Any]:
    """Write the images of a frame; return its row."""
    pose = sequence.Ts_world_camera[index] @ _R_CAMERA_GL
    row: dict[str, Any] = {
        "file_path": f"images/{_camera(sequence).name}/frame_{index + 1:06d}.png",
        "transform_matrix": pose.tolist(),
    }
    images = [(root / row["file_path"], sequence.image("rgb", index))]
    if "depth" in sequence.channels:
        row["depth_file_path"] = f"depths/{_camera(sequence).name}/frame_{index + 1:06d}.npy"
        stored = sequence.image("depth", index) / _depth_scale(_camera(sequence)) / MM
        stored = np.nan_to_num(stored).astype(np.float32)
        images.append((root / row["depth_file_path"], stored))
    for path, _ in images:
        path.parent.mkdir(parents=True, exist_ok=True)
    write_images(images)
    return row


def _depth_scale(camera: Camera) -> Float[np.ndarray, "h w"] | float:
    """Camera z of a stored depth of 1."""
    if camera.lens.kind == "pinhole":
        return 1.0
    z = camera_rays(camera)[..., 2].astype(float)
    return np.where(z > 0.0, z, np.nan)


def _write_mask(root: Path, sequence: FrameSequence) -> dict[str, str]:
    """Write the mask of valid pixels; return its key for the rows."""
    path = f"masks/{_camera(sequence).name}.png"
    (root / path).parent.mkdir(exist_ok=True)
    sees = np.isfinite(_rays(sequence)[..., 0])
    write_images([(root / path, np.where(sees, np.uint8(255), np.uint8(0)))])
    return {"mask_path": path}


def _read_file(root: Path, split: str | None) -> list[FrameSequence]:
    content = read_plain(root / _FILE, "transforms")
    where = str(root / _FILE)
    try:
        groups: dict[Path, list[dict[str, Any]]] = {}
        for frame in content["frames"]:
            groups.setdefault(Path(frame["file_path"]).parent, []).append(frame)
        return [
            _read_group(root, split, content, folder, frames) for folder, frames in groups.items()
        ]
    except (KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{where} is not a nerfstudio file: {error} is missing.") from error


def _read_group(
    root: Path,
    split: str | None,
    content: dict[str, Any],
    folder: Path,
    frames: list[dict[str, Any]],
) -> FrameSequence:
    name = folder.name if len(folder.parts) > 1 else "camera"
    camera = _read_camera({**content, **frames[0]}, name, str(root / _FILE))
    paths = {"rgb": [inside(root, frame["file_path"]) for frame in frames]}
    readers: dict[str, Callable[[Path], NDArray]] = {"rgb": read_rgb}
    if all("depth_file_path" in frame for frame in frames):
        paths["depth"] = [inside(root, frame["depth_file_path"]) for frame in frames]
        readers["depth"] = partial(_read_depth, _depth_scale(camera))
    poses = np.array([frame["transform_matrix"] for frame in frames], float) @ _R_CAMERA_GL
    return FrameSequence(
        f"{root.name}/{name}",
        tuple(paths),
        {TIME: read_times(root, range(len(frames)), 1.0), CAMERA_POSE: poses},
        image_loader(paths, readers),
        camera,
        split=split,
    )


def _read_camera(values: dict[str, Any], name: str, where: str) -> Camera:
    given = {key: float(values[key]) for key in _LENS_KEYS if key in values}
    given |= {"fx": given["fl_x"], "fy": given["fl_y"]}
    lens = lens_from_colmap(values.get("camera_model", "OPENCV"), given, where)
    return Camera(name, lens, int(values["w"]), int(values["h"]))


def _read_depth(scale: Float[np.ndarray, "h w"] | float, path: Path) -> NDArray:
    stored = read_numbers(path)
    return np.where(stored > 0, stored * MM * scale, np.nan).astype(np.float32)
