"""Table `frames.parquet`: one row per frame, units in the column names; reader of Parquet files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps._core import Wall
from vrcaps.core.errors import InputError, UnknownNameError, reading
from vrcaps.core.files import MAX_BYTES, write_bytes
from vrcaps.core.geometry import (
    barycentric,
    matrix_from_quaternion,
    quaternion_from_matrix,
    rotate_vectors,
    transform_from,
    transform_points,
)
from vrcaps.motion.dynamics_settings import SPEED_ALONG_GUT
from vrcaps.motion.motion import Motion, Step
from vrcaps.organ.surface import face_label
from vrcaps.world.model import Model, MovingWall

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet as pq
    from jaxtyping import Float
    from numpy.typing import NDArray

POSE_COLUMNS = ("x_m", "y_m", "z_m", "qw", "qx", "qy", "qz")
_LINEAR = tuple(f"capsule_v{axis}_m_per_s" for axis in "xyz")
_ANGULAR = tuple(f"capsule_w{axis}_rad_per_s" for axis in "xyz")


@dataclass(frozen=True)
class FrameTable:
    """Columns of `frames.parquet` by name; all [n].

    Poses are in the world frame, under `capsule_…` and `<camera>_…`: position of the body's
    origin, and unit quaternion (w ≥ 0) of the rotation from body to world axes.
    """

    columns: dict[str, np.ndarray]

    def __len__(self) -> int:
        return len(self.columns["frame"])

    def poses(self, body: str) -> Float[np.ndarray, "n 4 4"]:
        """Return ``Ts_world_body`` of `capsule` or a camera.

        Raises:
            UnknownNameError: If the table has no pose of that name.
        """
        if not self.columns.keys() >= {f"{body}_{name}" for name in POSE_COLUMNS}:
            known = [name.removesuffix("_qw") for name in self.columns if name.endswith("_qw")]
            raise UnknownNameError("pose", body, known)
        x, y, z, *wxyz = (self.columns[f"{body}_{name}"] for name in POSE_COLUMNS)
        rotations = matrix_from_quaternion(np.stack(wxyz, axis=-1))
        return transform_from(rotations, np.stack([x, y, z], axis=-1))


def column_names(cameras: tuple[str, ...]) -> tuple[str, ...]:
    """Names of the columns of every table, in order.

    Args:
        cameras: Names of the capsule's cameras.
    """
    poses = [f"{body}_{name}" for body in ("capsule", *cameras) for name in POSE_COLUMNS]
    clearances = [f"{body}_clearance_m" for body in ("capsule", *cameras)]
    columns = ("frame", "time_s", *poses, *_LINEAR, *_ANGULAR, "arc_length_m", "segment")
    return (*columns, *clearances, "wall_at_rest")


class TableRows:
    """Rows of a run, collected frame by frame."""

    def __init__(
        self, model: Model, before: FrameTable | None = None, wall: MovingWall | None = None
    ) -> None:
        """Start a table, or continue with the rows of an earlier one.

        Args:
            model: Recorded model.
            before: Rows of the previous frames.
            wall: The model's wall, shared with other users of the same states.
        """
        self.model = model
        self._wall = wall or MovingWall(model)
        self._rows: list[dict[str, Any]] = []
        if before is not None:
            columns = before.columns
            self._rows = [{k: v[i] for k, v in columns.items()} for i in range(len(before))]

    def __len__(self) -> int:
        return len(self._rows)

    def add(self, step: Step, more: Mapping[str, float | str] | None = None) -> None:
        """Add a frame: pose, velocity, gut coordinates, distance to the deformed wall.

        Args:
            step: Current frame.
            more: Additional columns, the same in each row.
        """
        state, cameras = step.state, self.model.device.cameras
        poses = {"capsule": state.T_world_capsule}
        for camera in cameras:
            poses[camera.name] = state.T_world_capsule @ camera.T_capsule_camera
        row: dict[str, Any] = {"frame": len(self._rows), "time_s": state.time}
        for body, T_world_body in poses.items():
            wxyz = quaternion_from_matrix(T_world_body[:3, :3])
            values = zip(POSE_COLUMNS, (*T_world_body[:3, 3], *wxyz), strict=True)
            row |= {f"{body}_{name}": value for name, value in values}
        row |= dict(zip(_LINEAR, state.linear_velocity_world, strict=True))
        row |= dict(zip(_ANGULAR, state.angular_velocity_world, strict=True))
        wall = self._wall.at(state)
        positions = state.T_world_capsule[None, :3, 3]
        arc_length, segment = locate_in_gut(self.model, positions, step=step, wall=wall)
        row |= {"arc_length_m": arc_length[0], "segment": segment[0]}
        origins = np.array([T_world_body[:3, 3] for T_world_body in poses.values()])
        clearances = np.asarray(wall.signed_distance(origins), float)
        row |= {f"{body}_clearance_m": d for body, d in zip(poses, clearances, strict=True)}
        row["wall_at_rest"] = state.vertices_world is None
        if step.command is not None:
            row[SPEED_ALONG_GUT] = _speed_along_gut(self.model, step, float(arc_length[0]))
        self._rows.append(row | dict(more or {}))

    def table(self) -> FrameTable:
        """All rows so far."""
        names = column_names(tuple(camera.name for camera in self.model.device.cameras))
        more = [name for name in self._rows[0] if name not in names] if self._rows else []
        columns = {name: np.array([row[name] for row in self._rows]) for name in (*names, *more)}
        texts = {
            name: column.astype(object)
            for name, column in columns.items()
            if column.dtype.kind == "U"
        }
        return FrameTable(columns | texts)


def make_table(model: Model, motion: Motion) -> FrameTable:
    """Table of a whole motion."""
    rows = TableRows(model)
    for step in motion.steps():
        rows.add(step, motion.columns(step))
    return rows.table()


def _speed_along_gut(model: Model, step: Step, arc_length: float) -> float:
    """Velocity of the capsule along the centerline, towards the anal end [m/s]."""
    assert step.command is not None
    line = model.organ.centerline
    tangent = np.array([np.interp(arc_length, line.arc_length, t) for t in line.frames[:, :, 2].T])
    along = rotate_vectors(step.command.T_world_patient, tangent) / np.linalg.norm(tangent)
    return float(along @ step.state.linear_velocity_world)


def locate_in_gut(
    model: Model,
    positions_world: Float[np.ndarray, "n 3"],
    *,
    step: Step | None = None,
    wall: Wall | None = None,
) -> tuple[Float[np.ndarray, " n"], np.ndarray]:
    """Arc length [m] and segment name of points in the lumen.

    The nearest wall determines the stretch of the gut, so that a neighboring loop is never
    chosen; within that stretch the nearest point of the centerline is used.

    Args:
        model: Model with the lumen.
        positions_world: Points to locate.
        step: Pose of wall and patient; None takes the rest state of the model.
        wall: Deformed wall; None takes the wall at rest.
    """
    organ = model.organ
    pose, vertices = model.T_world_patient, model.vertices_world
    if step is not None and step.command is not None:
        pose = step.command.T_world_patient
    if step is not None and step.state.vertices_world is not None:
        vertices = step.state.vertices_world
    nearest, faces = (wall or model.wall).closest_point(positions_world)
    weights = barycentric(nearest, vertices[organ.faces[faces]])
    rough = (weights * organ.arc_length[organ.faces[faces]]).sum(axis=1)
    reach = 2.0 * organ.radius[organ.faces[faces]].max(axis=1)
    line = transform_points(pose, organ.centerline.points)
    arc_length = np.empty(len(positions_world))
    for index, (position, s, span) in enumerate(zip(positions_world, rough, reach, strict=True)):
        low, high = np.searchsorted(organ.centerline.arc_length, [s - span, s + span])
        low, high = min(low, len(line) - 2), max(high, low + 2)
        arc_length[index] = _project(
            position, line[low:high], organ.centerline.arc_length[low:high]
        )
    label = face_label(organ.label, organ.faces[faces])
    return arc_length, np.array(organ.label_names, object)[label]


def _project(
    point: Float[np.ndarray, " 3"], line: Float[np.ndarray, "n 3"], s: Float[np.ndarray, " n"]
) -> float:
    """Arc length of the nearest point on a polyline."""
    steps = np.diff(line, axis=0)
    along = ((point - line[:-1]) * steps).sum(axis=1) / np.maximum((steps**2).sum(axis=1), 1e-30)
    along = np.clip(along, 0.0, 1.0)
    nearest = line[:-1] + along[:, None] * steps
    best = int(np.argmin(((nearest - point) ** 2).sum(axis=1)))
    return float(s[best] + along[best] * (s[best + 1] - s[best]))


def write_table(path: Path, table: FrameTable) -> None:
    """Write a table as Parquet; the same table gives the same bytes."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    arrays = [_arrow_array(column) for column in table.columns.values()]
    buffer = pa.BufferOutputStream()
    pq.write_table(
        pa.Table.from_arrays(arrays, names=list(table.columns)), buffer, compression="zstd"
    )
    write_bytes(path, buffer.getvalue().to_pybytes())


def _arrow_array(column: NDArray) -> pa.Array:
    """Column as an Arrow array, without `pyarrow.array`, whose import of pandas takes a second."""
    import pyarrow as pa

    if column.dtype.kind == "O":
        texts = [text.encode() for text in column]
        ends = np.cumsum([0, *map(len, texts)], dtype=np.int32)
        buffers = [None, pa.py_buffer(ends), pa.py_buffer(b"".join(texts))]
        return pa.Array.from_buffers(pa.string(), len(column), buffers)
    is_bool = column.dtype.kind == "b"
    values = np.packbits(column, bitorder="little") if is_bool else np.ascontiguousarray(column)
    kind = pa.from_numpy_dtype(column.dtype)
    return pa.Array.from_buffers(kind, len(column), [None, pa.py_buffer(values)])


def read_table(path: Path) -> FrameTable:
    """Read a table.

    Raises:
        InputError: If the file cannot be read or is not a Parquet file.
    """
    with reading(path.name):
        return decode_table(path.read_bytes(), path.name)


def decode_table(data: bytes, name: str) -> FrameTable:
    """Decode a table from the bytes of its file.

    Args:
        data: Contents of the file.
        name: Name of the file, for messages.

    Raises:
        InputError: If it is not a Parquet file.
    """
    with open_parquet(data, name) as file:
        table = file.read(use_threads=False)  # a small file: threads would be slower
        return FrameTable({column: _numpy_array(table[column]) for column in table.column_names})


def _numpy_array(column: pa.ChunkedArray) -> NDArray:
    """Values of a column; `pyarrow`'s conversion, which imports pandas, is used only if needed."""
    import pyarrow as pa

    kind = column.type
    is_plain = pa.types.is_integer(kind) or pa.types.is_floating(kind)
    if column.null_count or not (is_plain or pa.types.is_string(kind) or pa.types.is_boolean(kind)):
        return column.to_numpy(zero_copy_only=False)
    if not is_plain:
        return np.array(column.to_pylist(), bool if pa.types.is_boolean(kind) else object)
    array = column.combine_chunks()
    dtype = np.dtype(kind.to_pandas_dtype())
    values = np.frombuffer(array.buffers()[1], dtype, offset=array.offset * dtype.itemsize)
    return values[: len(array)].copy()


def require_table(table: FrameTable, cameras: tuple[str, ...], frames: int) -> None:
    """Check that a table has all required columns and a row for each frame.

    Args:
        table: Table of an episode.
        cameras: Names of the capsule's cameras.
        frames: Number of frames.

    Raises:
        InputError: If a column or a row is missing, or a numeric column holds text.
    """
    names = column_names(cameras)
    missing = sorted(set(names) - set(table.columns))
    if missing:
        raise InputError(f"frames.parquet lacks the columns {', '.join(missing)}.")
    for name in names:
        if name != "segment" and table.columns[name].dtype.kind not in "bfiu":
            raise InputError(f"frames.parquet: column {name} does not hold numbers.")
    if len(table) != frames:
        raise InputError(f"frames.parquet has {len(table)} rows for {frames} frames.")


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
