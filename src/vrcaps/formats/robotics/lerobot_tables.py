"""LeRobot tables: frames, tasks and episodes, as Parquet."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.core.files import write_bytes
from vrcaps.recording.parquet_files import open_parquet

if TYPE_CHECKING:
    import pyarrow as pa

_INDEX = "__index_level_0__"
"""Column in which pandas stores row names."""


def arrow_kind(feature: Mapping[str, Any]) -> tuple[pa.DataType, dict[str, Any]]:
    """Type of a feature's column for Arrow and for Hugging Face.

    Args:
        feature: `dtype` and `shape`, as in `info.json`.
    """
    import pyarrow as pa

    if feature["dtype"] == "image":
        return pa.struct({"bytes": pa.binary(), "path": pa.string()}), {"_type": "Image"}
    kind = pa.type_for_alias(feature["dtype"])
    value, shape = {"dtype": feature["dtype"], "_type": "Value"}, feature["shape"]
    if shape == [1]:
        return kind, value
    if len(shape) == 1:
        sequence = {"feature": value, "length": shape[0], "_type": "Sequence"}
        return pa.list_(kind, shape[0]), sequence
    array = {"shape": list(shape), "dtype": feature["dtype"], "_type": "Array2D"}
    return pa.list_(pa.list_(kind)), array


def write_frames(
    path: Path, features: Mapping[str, Mapping[str, Any]], columns: Mapping[str, Any]
) -> None:
    """Write the frames of an episode.

    Args:
        path: Path of the file.
        features: Features of `info.json`; videos have no column.
        columns: Values of each feature.
    """
    import pyarrow as pa

    kinds = {name: arrow_kind(one) for name, one in features.items() if one["dtype"] != "video"}
    about = {"info": {"features": {name: kind for name, (_, kind) in kinds.items()}}}
    schema = pa.schema(
        [(name, kind) for name, (kind, _) in kinds.items()], {"huggingface": json.dumps(about)}
    )
    arrays = [_array(columns[name], kinds[name][0]) for name in kinds]
    _write(path, pa.Table.from_arrays(arrays, schema=schema))


def write_tasks(path: Path, tasks: Sequence[str]) -> None:
    """Write the tasks; pandas reads their texts as row names."""
    import pyarrow as pa

    text = {"pandas_type": "unicode", "numpy_type": "object", "metadata": None}
    number = {"pandas_type": "int64", "numpy_type": "int64", "metadata": None}
    about = {
        "index_columns": [_INDEX],
        "column_indexes": [
            {"name": None, "field_name": None, **text, "metadata": {"encoding": "UTF-8"}}
        ],
        "columns": [
            {"name": "task_index", "field_name": "task_index", **number},
            {"name": None, "field_name": _INDEX, **text},
        ],
        "creator": {"library": "pyarrow", "version": pa.__version__},
        "pandas_version": "2.2.0",
    }
    fields = [("task_index", pa.int64()), (_INDEX, pa.string())]
    columns = {"task_index": range(len(tasks)), _INDEX: tasks}
    schema = pa.schema(fields, {"pandas": json.dumps(about)})
    _write(path, pa.table({name: list(values) for name, values in columns.items()}, schema))


def write_episodes(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write a row for each episode."""
    import pyarrow as pa

    _write(path, pa.Table.from_pylist([dict(row) for row in rows]))


def read_rows(path: Path, names: Sequence[str] | None = None) -> list[dict[str, Any]]:
    """Rows of a table.

    Args:
        path: Path of the file.
        names: Names of the columns to read; None reads all.

    Raises:
        InputError: If it cannot be read.
    """
    with open_parquet(path, path) as file:
        return file.read(names).to_pylist()


def _array(values: Any, kind: pa.DataType) -> pa.Array:
    """Arrow column; multi-dimensional arrays are not copied to Python lists."""
    import pyarrow as pa

    if not isinstance(values, np.ndarray) or values.ndim == 1:
        return pa.array(values, kind)
    flat = pa.array(np.ascontiguousarray(values).ravel())
    if values.ndim == 2:
        return pa.FixedSizeListArray.from_arrays(flat, values.shape[1])
    count, height, width = values.shape
    rows = pa.ListArray.from_arrays(np.arange(count * height + 1, dtype=np.int32) * width, flat)
    return pa.ListArray.from_arrays(np.arange(count + 1, dtype=np.int32) * height, rows)


def _write(path: Path, table: pa.Table) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    path.parent.mkdir(parents=True, exist_ok=True)
    buffer = pa.BufferOutputStream()
    pq.write_table(table, buffer, compression="zstd")
    write_bytes(path, buffer.getvalue().to_pybytes())
