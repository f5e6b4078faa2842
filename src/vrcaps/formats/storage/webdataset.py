"""WebDataset: samples in tar files of a given size, read sequentially.

A sample consists of consecutive files with the same key: ``KEY.rgb.png``, ``KEY.depth.png``, …,
``KEY.json``. The key ends at the first dot of a file's name, so it has none. Files have no owner
and no time: the same frames give the same bytes. Source: https://github.com/webdataset/webdataset.
"""

from __future__ import annotations

import io
import json
import tarfile
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from vrcaps.config.plain_files import decode_json
from vrcaps.core import rng
from vrcaps.core.errors import InputError, reading
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.files import atomic_write
from vrcaps.core.names import listed
from vrcaps.formats.format import Needs
from vrcaps.formats.storage.samples import (
    Sample,
    by_split,
    frames_of,
    require_unique_names,
    sample_images,
    sample_key,
    sample_values,
    sequences_from,
    suffix,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from vrcaps.formats.format import Advance
    from vrcaps.recording.frame_sequence import FrameSequence

_MB = 1e6


@dataclass(frozen=True)
class WebDataset:
    """WebDataset shards: `train/000000.tar` with `KEY.rgb.png`, `KEY.depth.png`, `KEY.json`.

    Attributes:
        shard_mb: Size at which a shard ends.
        seed: Random seed to shuffle the frames of each split before writing; by default they are in
            order of time.
    """

    shard_mb: Annotated[float, Range(above=0.0, unit="MB")] = 1000.0
    seed: Annotated[int | None, Range(0, rng.MAX_SEED)] = None

    kind: ClassVar[str] = "webdataset"
    needs: ClassVar[Needs] = Needs(channels=(), poses=False)

    def __post_init__(self) -> None:
        check_fields(self)

    def write(self, sequences: Sequence[FrameSequence], folder: Path, advance: Advance) -> None:
        """Write a folder of shards for each split, or one if there are no splits."""
        require_unique_names(sequences)
        for split, own in by_split(sequences).items():
            frames = list(frames_of(own))
            if self.seed is not None:
                generator = rng.stream(self.seed, f"formats/webdataset/{split}")
                frames = [frames[k] for k in generator.permutation(len(frames))]
            with _Shards(folder / (split or ""), self.shard_mb * _MB) as shards:
                for sequence, index in frames:
                    key = sample_key(sequence, index)
                    images = sample_images(sequence, index)
                    files = {f"{key}.{name}{suffix(name)}": data for name, data in images.items()}
                    values = json.dumps(sample_values(sequence, index), ensure_ascii=False)
                    shards.add(files | {f"{key}.json": values.encode()})
                    advance()

    def read(self, folder: Path) -> tuple[FrameSequence, ...]:
        """Return the sequences of all shards; the index is read immediately, images on demand.

        Raises:
            InputError: If there are no shards, or one is damaged or not written by vrcaps.
        """
        paths = listed(folder, "**/*.tar")
        if not paths:
            raise InputError(f"{folder} contains no .tar, so it is not a WebDataset.")
        samples = (sample for path in paths for sample in _samples(path))
        return sequences_from(samples, _read, str(folder))


class _Shards:
    """Tar files of a folder; a new one starts when the last has reached its size."""

    def __init__(self, folder: Path, max_bytes: float) -> None:
        folder.mkdir(exist_ok=True)
        self._folder, self._max_bytes = folder, max_bytes
        self._open = ExitStack()
        self._count, self._tar = 0, None

    def __enter__(self) -> _Shards:
        return self

    def __exit__(self, *error: object) -> None:
        self._open.__exit__(*error)  # type: ignore[arg-type]

    def add(self, files: dict[str, bytes]) -> None:
        """Write the files of one sample into one shard."""
        if self._tar is None or self._tar.offset >= self._max_bytes:
            self._open.close()
            path = self._folder / f"{self._count:06d}.tar"
            temporary = self._open.enter_context(atomic_write(path))
            self._tar = self._open.enter_context(tarfile.TarFile(temporary, "w"))
            self._count += 1
        for name, data in files.items():
            info = tarfile.TarInfo(name)  # of no owner, at time 0
            info.size = len(data)
            self._tar.addfile(info, io.BytesIO(data))


def _samples(path: Path) -> Iterator[Sample]:
    """Samples of a shard; the files of a sample are consecutive."""
    locations: dict[str, dict[str, tuple[Path, int, int]]] = {}
    whole = path.stat().st_size
    with reading(path), tarfile.open(path, "r:") as tar:
        for member in tar:
            if not member.isreg() or member.offset_data + member.size > whole:
                raise ValueError(f"{member.name} is not a complete file")
            key, _, kind = member.name.partition(".")
            location = (path, member.offset_data, member.size)
            locations.setdefault(key, {})[kind.partition(".")[0]] = location
    for key, kinds in locations.items():
        if "json" not in kinds:
            raise InputError(f"{path}: the sample {key} has no .json. Allowed: what vrcaps writes.")
        yield Sample(decode_json(_read(kinds.pop("json")), f"{path}: {key}.json"), kinds)


def _read(location: tuple[Path, int, int]) -> bytes:
    """Bytes of a file in a shard."""
    path, offset, size = location
    with path.open("rb") as file:
        file.seek(offset)
        return file.read(size)
