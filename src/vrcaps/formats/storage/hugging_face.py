"""Hugging Face data set: Parquet files per split, one row per frame.

``data/<split>-00000-of-0000N.parquet``; a README whose header names the splits. Images are columns
of type ``Image`` (a file's bytes and its name); those that Pillow cannot read losslessly (16-bit
color, `.npy`) are plain bytes. Parquet's metadata hold the column types under ``huggingface``.
Source: https://huggingface.co/docs/datasets/about_dataset_features and
https://huggingface.co/docs/hub/datasets-manual-configuration.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from vrcaps.config.plain_files import front_matter, size_category
from vrcaps.core.errors import InputError
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.files import write_bytes
from vrcaps.core.names import listed
from vrcaps.formats.format import Needs
from vrcaps.formats.storage.samples import (
    Sample,
    by_split,
    channel_meaning,
    frames_of,
    require_unique_names,
    sample_images,
    sample_key,
    sample_values,
    sequences_from,
    suffix,
)
from vrcaps.recording.table import open_parquet
from vrcaps.render.channels import CHANNELS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from vrcaps.formats.format import Advance
    from vrcaps.recording.frame_sequence import FrameSequence

_MB = 1e6
_GROUP = 32
"""Number of rows read at once."""
_SPLIT = "train"
"""Default split: every data set of Hugging Face has one."""
_TEXTS, _LISTS = ("sequence", "patient", "camera"), ("label_names", "channels")
"""Columns of strings, and of lists of strings, in every data set."""


@dataclass(frozen=True)
class HuggingFace:
    """Hugging Face data set: Parquet files in `data/` and a README that names the splits.

    Attributes:
        shard_mb: Size of the images at which a file ends.
    """

    shard_mb: Annotated[float, Range(above=0.0, unit="MB")] = 130.0

    kind: ClassVar[str] = "hugging-face"
    needs: ClassVar[Needs] = Needs(channels=(), poses=False)

    def __post_init__(self) -> None:
        check_fields(self)

    def write(self, sequences: Sequence[FrameSequence], folder: Path, advance: Advance) -> None:
        """Write the files of each split, and the README."""
        require_unique_names(sequences)
        columns = _Columns.of(sequences)
        target, splits = folder / "data", by_split(sequences)
        target.mkdir()
        for split, own in splits.items():
            paths = []
            for rows in self._shards(own, advance):
                paths.append(target / f"{len(paths)}.partial")
                _write_rows(paths[-1], columns, rows)
            for number, path in enumerate(paths):
                name = f"{split or _SPLIT}-{number:05d}-of-{len(paths):05d}.parquet"
                path.rename(target / name)
        names = [split or _SPLIT for split in splits]
        num_frames = sum(map(len, sequences))
        write_bytes(folder / "README.md", _readme(names, columns, num_frames).encode())

    def read(self, folder: Path) -> tuple[FrameSequence, ...]:
        """Return the sequences of all files; images are read on demand.

        Raises:
            InputError: If there are no such files, or one is damaged or not written by vrcaps.
        """
        paths = listed(folder, "data/*.parquet")
        if not paths:
            raise InputError(
                f"{folder} contains no data/*.parquet, so it is not a Hugging Face data set."
            )
        samples = (sample for path in paths for sample in _samples(path))
        return sequences_from(samples, _read, str(folder))

    def _shards(
        self, sequences: Sequence[FrameSequence], advance: Advance
    ) -> Iterator[Iterator[list[dict[str, Any]]]]:
        """Row groups of each file in turn."""
        frames = frames_of(sequences)
        following = next(frames, None)

        def groups() -> Iterator[list[dict[str, Any]]]:
            nonlocal following
            size, rows = 0, []
            while following is not None and size < self.shard_mb * _MB:
                images = sample_images(*following)
                rows.append(_row(*following, images))
                size += sum(map(len, images.values()))
                advance()
                following = next(frames, None)
                if len(rows) == _GROUP:
                    yield rows
                    rows = []
            if rows:
                yield rows

        while following is not None:
            yield groups()


@dataclass(frozen=True)
class _Columns:
    """Columns of all files of a data set: the union over its sequences."""

    channels: tuple[str, ...]
    values: dict[str, int]
    """Number of axes of a frame's values."""

    @classmethod
    def of(cls, sequences: Sequence[FrameSequence]) -> _Columns:
        channels = {channel for sequence in sequences for channel in sequence.channels}
        values = {
            name: rows.ndim - 1 for sequence in sequences for name, rows in sequence.values.items()
        }
        return cls(tuple(name for name in CHANNELS if name in channels), values)

    def schema(self) -> Any:
        """Arrow schema, with the Hugging Face column types."""
        import pyarrow as pa

        fields: dict[str, tuple[Any, Any]] = {name: _value(pa.string()) for name in _TEXTS}
        fields["index"] = _value(pa.int32())
        for name in _LISTS:
            fields[name] = _list_of(_value(pa.string()))
        for name, axes in self.values.items():
            fields[name] = _value(pa.float64())
            for _ in range(axes):
                fields[name] = _list_of(fields[name])
        image = pa.struct({"bytes": pa.binary(), "path": pa.string()})
        for channel in self.channels:
            is_image = _is_image(channel)
            fields[channel] = (image, {"_type": "Image"}) if is_image else _value(pa.binary())
        kinds = {name: kind for name, (_, kind) in fields.items()}
        metadata = {"huggingface": json.dumps({"info": {"features": kinds}})}
        return pa.schema([(name, kind) for name, (kind, _) in fields.items()], metadata)


def _value(kind: Any) -> tuple[Any, Any]:
    """Column type of plain values: for Arrow and for Hugging Face."""
    name = {"double": "float64"}.get(str(kind), str(kind))
    return kind, {"dtype": name, "_type": "Value"}


def _list_of(column: tuple[Any, Any]) -> tuple[Any, Any]:
    import pyarrow as pa

    kind, feature = column
    return pa.list_(kind), {"feature": feature, "_type": "Sequence"}


def _is_image(channel: str) -> bool:
    """Return whether Pillow reads a channel's files losslessly: false for 16-bit color PNG."""
    encoding = CHANNELS[channel].encoding
    return encoding.suffix == ".png" and (encoding.dtype == "uint8" or encoding.planes == 1)


def _row(sequence: FrameSequence, index: int, images: dict[str, bytes]) -> dict[str, Any]:
    row = sample_values(sequence, index)
    row["camera"] = None if row["camera"] is None else json.dumps(row["camera"])
    key = sample_key(sequence, index)
    for channel, data in images.items():
        name = f"{key}.{channel}{suffix(channel)}"
        row[channel] = {"bytes": data, "path": name} if _is_image(channel) else data
    del row["split"]  # given by the file name
    return row | {"channels": list(sequence.channels)}


def _write_rows(path: Path, columns: _Columns, groups: Iterator[list[dict[str, Any]]]) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    schema = columns.schema()
    repeated: Any = [*_TEXTS, *(f"{name}.list.element" for name in _LISTS)]
    with pq.ParquetWriter(path, schema, compression="zstd", use_dictionary=repeated) as writer:
        for rows in groups:
            writer.write_table(pa.Table.from_pylist(rows, schema))


def _samples(path: Path) -> Iterator[Sample]:
    """Samples of a file, without images."""
    split = path.name.rpartition("-of-")[0].rpartition("-")[0] or path.stem
    with open_parquet(path, path) as file:
        names = [name for name in file.schema_arrow.names if name not in CHANNELS]
        for group in range(file.num_row_groups):
            for k, row in enumerate(file.read_row_group(group, names).to_pylist()):
                images = {n: (path, group, k, n) for n in row.get("channels", ())}
                yield Sample(_plain(row, split), images)


def _plain(row: dict[str, Any], split: str) -> dict[str, Any]:
    """Convert a row to the sample that it was written from."""
    camera = row.get("camera")
    known = {name: value for name, value in row.items() if value is not None or name in _TEXTS}
    more = {"camera": None if camera is None else json.loads(camera), "split": split}
    return known | more


def _read(location: tuple[Path, int, int, str]) -> bytes:
    path, group, row, channel = location
    stored = _column(path, group, f"{channel}.bytes" if _is_image(channel) else channel)[row]
    return (stored["bytes"] if _is_image(channel) else stored).as_py()


@lru_cache(maxsize=16)
def _column(path: Path, group: int, name: str) -> Any:
    """Column of a row group."""
    with open_parquet(path, path) as file:
        return file.read_row_group(group, [name]).column(0)


def _readme(splits: list[str], columns: _Columns, num_frames: int) -> str:
    """Dataset card: a header with the splits, and the meaning of the columns."""
    files = [{"split": name, "path": f"data/{name}-*"} for name in splits]
    header = front_matter(
        {
            "tags": ("endoscopy", "capsule-endoscopy", "medical", "vrcaps"),
            "size_categories": [size_category(num_frames)],
            "configs": [{"config_name": "default", "data_files": files}],
        }
    )
    return f"{header}\n# Dataset Card\n\n## Dataset Structure\n\n{_table(columns)}"


def _table(columns: _Columns) -> str:
    lines = [
        "A row is a frame of a camera. SI units; poses `T_a_b` take points of b to a, 4×4, row by",
        "row; camera axes are x right, y down, z forward; `camera` is its lens and size as JSON.",
        "",
        "| column | meaning | value of a stored number | no value |",
        "|---|---|---|---|",
    ]
    for channel in columns.channels:
        about = channel_meaning(channel)
        scale, offset = about.get("scale"), about.get("offset")
        value = "itself" if scale is None else f"stored · {scale:.9g} + {offset:.9g}"
        none = "" if about.get("invalid") is None else f"{about['invalid']}"
        meaning = f"{about['meaning']} [{about['unit']}]"
        lines.append(f"| `{channel}` | {meaning} | {value} | {none} |")
    return "\n".join(lines) + "\n"
