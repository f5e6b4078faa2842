"""Mucosa textures on disk: a folder of images and their metadata."""

from __future__ import annotations

import json
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vrcaps import _core
from vrcaps.core.errors import InputError
from vrcaps.core.files import atomic_write, file_sha256, is_new_folder, write_json
from vrcaps.core.units import MM

if TYPE_CHECKING:
    from jaxtyping import Float, UInt8, UInt16

FORMAT = "vrcaps-mucosa/1"
HEAD = "mucosa.json"
HEIGHT_STEP = 1e-8
"""Step of the relief in its 16-bit image [m]; 32768 is 0."""

_PICTURES = ("albedo", "roughness", "height")


@dataclass(frozen=True)
class MucosaTexture:
    """Square texture of a mucosa, periodic across its edges.

    Attributes:
        albedo: Base color, sRGB-encoded.
        roughness: Perceptual roughness, 255 = 1.
        height: Relief towards the lumen in steps of `HEIGHT_STEP`, 32768 = 0.
        texel: Side length of a texel [m].
        clearcoat_gloss: Gloss of the wet film, 0 (satin) to 1 (mirror-like).
        metadata: Origin: photographs, regions, seed, measurements.
    """

    albedo: UInt8[np.ndarray, "n n 3"]
    roughness: UInt8[np.ndarray, "n n"]
    height: UInt16[np.ndarray, "n n"]
    texel: float
    clearcoat_gloss: float = 0.93
    metadata: dict = field(default_factory=dict)

    @property
    def side(self) -> float:
        """Side length of the square [m]."""
        return len(self.albedo) * self.texel

    @property
    def relief(self) -> Float[np.ndarray, "n n"]:
        """Relief towards the lumen [m]."""
        return (self.height.astype(np.float32) - 32768.0) * np.float32(HEIGHT_STEP)


def write_texture(folder: Path, texture: MucosaTexture) -> None:
    """Write a texture as a folder, replacing an existing texture.

    Raises:
        InputError: If the folder contains anything but a texture.
    """
    check_free(folder)
    folder.mkdir(parents=True, exist_ok=True)
    with ExitStack() as files:
        paths = {f"{name}.png": folder / f"{name}.png" for name in _PICTURES}
        temporary = {name: files.enter_context(atomic_write(p)) for name, p in paths.items()}
        images = [getattr(texture, name) for name in _PICTURES]
        _core.write_pngs([(str(p), i) for p, i in zip(temporary.values(), images, strict=True)])
        head = {
            "format": FORMAT,
            "mm_per_texel": texture.texel / MM,
            "height_step_m": HEIGHT_STEP,
            "height_zero": 32768,
            "clearcoat_gloss": texture.clearcoat_gloss,
            "sha256": {name: file_sha256(path) for name, path in temporary.items()},
            **texture.metadata,
        }
        # Before the images get their final names: a folder with a head is replaced after a kill.
        write_json(folder / HEAD, head)


def check_free(folder: Path) -> None:
    """Check that `write_texture` will not mix with, or replace, anything else at a path.

    Raises:
        InputError: If it is a file, or a folder that contains anything but a texture.
    """
    if not (folder / HEAD).is_file() and not is_new_folder(folder):
        raise InputError(f"{folder} exists and is not a texture. Give a new or an empty folder.")


def read_texture(path: str | Path) -> MucosaTexture:
    """Read a texture written by `write_texture`.

    Args:
        path: The folder, or its `mucosa.json`.

    Raises:
        InputError: If there is no texture, or an image is not the one written with it.
    """
    head_path = texture_head(path)
    try:
        head = json.loads(head_path.read_text("utf-8-sig"))
        if head["format"] != FORMAT:
            raise InputError(f"{head_path} has format {head['format']!r}. Allowed: {FORMAT!r}.")
        expected, texel = dict(head["sha256"]), float(head["mm_per_texel"]) * MM
        gloss, step = float(head["clearcoat_gloss"]), float(head["height_step_m"])
    except (OSError, UnicodeDecodeError, json.JSONDecodeError, RecursionError) as error:
        raise InputError(f"Cannot read the texture {head_path}: {error}.") from error
    except (KeyError, TypeError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{head_path} lacks {error}. Create the texture again.") from error
    if step != HEIGHT_STEP or not (0.0 < texel < 1.0 and 0.0 <= gloss <= 1.0):
        raise InputError(f"{head_path} has values out of range. Create the texture again.")
    for name in _PICTURES:
        file = head_path.with_name(f"{name}.png")
        if not file.is_file() or file_sha256(file) != expected.get(file.name):
            raise InputError(
                f"{file} is missing or not the picture that {HEAD} was written with. "
                "Create the texture again."
            )
    paths = {name: str(head_path.with_name(f"{name}.png")) for name in _PICTURES}
    try:
        images = {name: _core.read_png(path) for name, path in paths.items()}
    except (OSError, ValueError) as error:
        raise InputError(f"Cannot read the texture {head_path}: {error}.") from error
    return MucosaTexture(**images, texel=texel, clearcoat_gloss=gloss, metadata=head)


def texture_head(path: str | Path) -> Path:
    """Return the file `mucosa.json` of a texture, given by its folder or by that file.

    Raises:
        InputError: If there is none.
    """
    path = Path(path)
    head = path / HEAD if path.is_dir() else path
    if head.name != HEAD or not head.is_file():
        raise InputError(
            f"{path} is not a mucosa texture. Allowed: a folder that `vrcaps organ texture` "
            f"wrote, or the {HEAD} in it."
        )
    return head


def texture_sha256(path: str | Path) -> str:
    """Checksum of a texture: that of its `mucosa.json`, which contains those of its images.

    Raises:
        InputError: If there is no texture.
    """
    return file_sha256(texture_head(path))
