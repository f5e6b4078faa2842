"""Parquet reader that checks sizes before anything is decompressed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from vrcaps.core.errors import reading
from vrcaps.core.files import MAX_BYTES

if TYPE_CHECKING:
    import pyarrow.parquet as pq


@contextmanager
def open_parquet(source: Path | bytes, name: object) -> Iterator[pq.ParquetFile]:
    """Open a Parquet file during the block.

    Args:
        source: Path of the file, or its bytes.
        name: Name of the file, for messages.

    Raises:
        InputError: If it is damaged or the block cannot read it, or if a row group declares more
            than `MAX_BYTES`.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    with (
        reading(name),
        pq.ParquetFile(pa.BufferReader(source) if isinstance(source, bytes) else source) as file,
    ):
        about = file.metadata
        sizes = [about.row_group(k).total_byte_size for k in range(about.num_row_groups)]
        if not all(0 <= size <= MAX_BYTES for size in sizes):
            raise ValueError(f"a row group declares {max(sizes)} bytes. Allowed: up to {MAX_BYTES}")
        yield file
