"""SimCol3D: synthetic colonoscopy with depth and poses, of the MICCAI 2022 challenge.

``SyntheticColon_I/Frames_S1/`` holds ``FrameBuffer_0000.png`` (color) and ``Depth_0000.png``, z as
``v / 255 / 256 · 20 cm`` in 16 bits: 3.06 µm per step, up to 20.08 cm. Next to the folders of
frames are ``SavedPosition_S1.txt`` (cm), ``SavedRotationQuaternion_S1.txt`` (xyzw), camera to world
in Unity's left-handed frame, and ``cam.txt``, K of all of them. Loaders multiply integer pixel
indices by the inverse of K, so (0, 0) is the center of a pixel, although the 237.5 of the real
files is half of 475 px, measured from the corner. Source: https://github.com/anitarau/simcol and
https://rdr.ucl.ac.uk/articles/dataset/24077763.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import numpy as np

from vrcaps.core.errors import narrow
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.files import write_bytes
from vrcaps.core.names import listed
from vrcaps.core.units import CM
from vrcaps.formats.endoscopy.unity import poses_from_unity, unity_from_poses
from vrcaps.formats.format import Needs
from vrcaps.formats.shared.folders import (
    by_number,
    find_folders,
    image_loader,
    matched,
    nearest_file,
    with_names,
    write_names,
)
from vrcaps.formats.shared.stored_images import read_plane, read_rgb
from vrcaps.formats.shared.text_files import (
    matrix_text,
    plain_pinhole,
    read_matrix_camera,
    read_rows,
    read_times,
    rows_of,
    write_times,
)
from vrcaps.recording.frame_files import write_images
from vrcaps.recording.frame_sequence import CAMERA_POSE, TIME, FrameSequence
from vrcaps.render.encoding import fixed_point

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from vrcaps.formats.format import Advance

_DEPTH = fixed_point("m", 20.0 * CM / (255 * 256))
_NUMERALS = ("I", "II", "III", "IV", "V", "VI", "VII", "VIII", "IX")
_LETTERS = {"II": "B", "III": "O"}
"""First letters of the frames' folders; S for all other colons."""
_LISTS = {"train": "train_file.txt", "val": "val_file.txt", "test": "test_file.txt"}


@dataclass(frozen=True)
class SimCol3D:
    """SimCol3D: `SyntheticColon_I/Frames_S1/FrameBuffer_0000.png`, depth, poses, `cam.txt`.

    Attributes:
        fps: Frames per second of data without `times.txt`, which only vrcaps writes.
    """

    fps: Annotated[float, Range(above=0.0, unit="Hz")] = 30.0

    kind: ClassVar[str] = "simcol3d"
    needs: ClassVar[Needs] = Needs(("rgb", "depth"), lenses=("pinhole",))

    def __post_init__(self) -> None:
        check_fields(self)

    def write(self, sequences: Sequence[FrameSequence], folder: Path, advance: Advance) -> None:
        """Write a `SyntheticColon_` folder per patient and lens; `sequences.json` holds the names.

        Raises:
            InputError: If a lens has distortion.
        """
        names = {}
        for numeral, own in self._colons(sequences).items():
            colon = folder / f"SyntheticColon_{numeral}"
            colon.mkdir()
            lists: dict[str, str] = {}
            for number, sequence in enumerate(own, start=1):
                name = f"{_LETTERS.get(numeral, 'S')}{number}"
                _write_one(colon, name, sequence, advance)
                part = _LISTS[sequence.split or "train"]
                lists[part] = lists.get(part, "") + f"Frames_{name}\n"
                names[f"{colon.name}/Frames_{name}"] = sequence
            for part, lines in lists.items():
                write_bytes(colon / part, lines.encode())
            write_bytes(colon / "cam.txt", matrix_text(plain_pinhole(self, own[0])).encode())
        write_names(folder, names)

    def read(self, folder: Path) -> tuple[FrameSequence, ...]:
        """Return the sequences of a folder; poses and `cam.txt` are optional.

        Raises:
            InputError: If it is not in this layout.
        """
        roots = [root for root, _ in find_folders(folder, "FrameBuffer_*.png")]
        return with_names(
            folder, ((f"{p.parent.name}/{p.name}", self._read_one(p, folder)) for p in roots)
        )

    def _colons(self, sequences: Sequence[FrameSequence]) -> dict[str, list[FrameSequence]]:
        """Sequences that share an organ and K, by Roman numeral."""
        groups: dict[tuple, list[FrameSequence]] = {}
        for sequence in sequences:
            key = (sequence.patient, sequence.split, matrix_text(plain_pinhole(self, sequence)))
            groups.setdefault(key, []).append(sequence)
        return {_numeral(k): group for k, group in enumerate(groups.values())}

    def _read_one(self, root: Path, folder: Path) -> FrameSequence:
        frames = by_number(listed(root, "FrameBuffer_*.png"))
        paths = matched({"rgb": frames, "depth": by_number(listed(root, "Depth_*.png"))})
        values = {TIME: read_times(root, frames, self.fps)}
        name = root.name.removeprefix("Frames_").removesuffix("_OP")
        positions = nearest_file(root, folder, f"SavedPosition_{name}.txt")
        if positions is not None:
            turns = positions.with_name(f"SavedRotationQuaternion_{name}.txt")
            xyz, xyzw = read_rows(positions, 3), read_rows(turns, 4)
            values[CAMERA_POSE] = poses_from_unity(
                CM * rows_of(xyz, frames, positions), rows_of(xyzw, frames, turns)
            )
        intrinsics = nearest_file(root, folder, "cam.txt")
        return FrameSequence(
            root.name,
            tuple(paths),
            values,
            image_loader(paths, {"rgb": read_rgb, "depth": _read_depth}),
            None if intrinsics is None else read_matrix_camera(intrinsics, paths["rgb"][0]),
        )


def _numeral(index: int) -> str:
    tens, ones = divmod(index + 1, 10)
    return "X" * tens + (_NUMERALS[ones - 1] if ones else "")


def _write_one(colon: Path, name: str, sequence: FrameSequence, advance: Advance) -> None:
    root = colon / f"Frames_{name}"
    root.mkdir()
    for index in range(len(sequence)):
        color, depth = sequence.image("rgb", index), sequence.image("depth", index)
        write_images(
            [
                (root / f"FrameBuffer_{index:04d}.png", color),
                (root / f"Depth_{index:04d}.png", _DEPTH.encode(depth)),
            ]
        )
        advance()
    write_times(root, sequence)
    positions, xyzw = unity_from_poses(sequence.Ts_world_camera)
    write_bytes(colon / f"SavedPosition_{name}.txt", _rows(positions / CM))
    write_bytes(colon / f"SavedRotationQuaternion_{name}.txt", _rows(xyzw))


def _rows(values: NDArray) -> bytes:
    lines = (" ".join(f"{value:.12g}" for value in row) for row in values)
    return "".join(f"{line}\n" for line in lines).encode()


def _read_depth(path: Path) -> NDArray:
    return _DEPTH.decode(narrow(read_plane(path), np.uint16, f"depths of {path}"))
