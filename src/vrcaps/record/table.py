"""`frames.parquet`: one row a frame, units in the column names."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.organ.surface import face_label
from vrcaps.record.files import write_bytes
from vrcaps.transforms import (
    matrix_from_quaternion,
    quaternion_from_matrix,
    transform_from,
    transform_points,
)
from vrcaps.world.model import Model
from vrcaps.world.trajectory import Trajectory, camera_clearance, camera_poses

if TYPE_CHECKING:
    from jaxtyping import Float

POSE_COLUMNS = ("x_m", "y_m", "z_m", "qw", "qx", "qy", "qz")
_LINEAR = tuple(f"capsule_v{axis}_m_per_s" for axis in "xyz")
_ANGULAR = tuple(f"capsule_w{axis}_rad_per_s" for axis in "xyz")


@dataclass(frozen=True)
class FrameTable:
    """Columns of `frames.parquet` by name; all [n].

    Poses are in the world frame: position of the body's origin and unit quaternion (w ≥ 0) that
    turns its axes into the world's, under `capsule_…` and `<camera>_…`.
    """

    columns: dict[str, np.ndarray]

    def __len__(self) -> int:
        return len(self.columns["frame"])

    def poses(self, body: str) -> Float[np.ndarray, "n 4 4"]:
        """``Ts_world_body`` of `capsule` or a camera."""
        x, y, z, *wxyz = (self.columns[f"{body}_{name}"] for name in POSE_COLUMNS)
        rotations = matrix_from_quaternion(np.stack(wxyz, axis=-1))
        return transform_from(rotations, np.stack([x, y, z], axis=-1))


def column_names(cameras: tuple[str, ...]) -> tuple[str, ...]:
    """Names of all columns, in order, for cameras of the given names."""
    poses = [f"{body}_{name}" for body in ("capsule", *cameras) for name in POSE_COLUMNS]
    clearances = [f"{body}_clearance_m" for body in ("capsule", *cameras)]
    return ("frame", "time_s", *poses, *_LINEAR, *_ANGULAR, "arc_length_m", "segment", *clearances)


def make_table(model: Model, trajectory: Trajectory) -> FrameTable:
    """Columns of a run: poses, velocities, where in the gut, how far from the wall."""
    cameras = model.device.cameras
    columns: dict[str, np.ndarray] = {
        "frame": np.arange(len(trajectory)),
        "time_s": trajectory.times,
    }
    poses = {"capsule": trajectory.Ts_world_capsule}
    for camera in cameras:
        poses[camera.name] = camera_poses(trajectory.Ts_world_capsule, camera.T_capsule_camera)
    for body, Ts_world_body in poses.items():
        values = [*Ts_world_body[:, :3, 3].T, *quaternion_from_matrix(Ts_world_body[:, :3, :3]).T]
        columns |= {f"{body}_{n}": v for n, v in zip(POSE_COLUMNS, values, strict=True)}
    columns |= dict(zip(_LINEAR, trajectory.linear_velocities_world.T, strict=True))
    columns |= dict(zip(_ANGULAR, trajectory.angular_velocities_world.T, strict=True))
    positions = trajectory.Ts_world_capsule[:, :3, 3]
    columns["arc_length_m"], columns["segment"] = locate(model, positions)
    columns["capsule_clearance_m"] = np.asarray(model.wall.signed_distance(positions), float)
    for camera, clearance in zip(cameras, camera_clearance(model, trajectory).T, strict=True):
        columns[f"{camera.name}_clearance_m"] = np.asarray(clearance, float)
    return FrameTable(
        {name: columns[name] for name in column_names(tuple(c.name for c in cameras))}
    )


def locate(
    model: Model, positions_world: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, " n"], np.ndarray]:
    """Arc length [m] and segment name of points in the lumen.

    The nearest wall says which stretch of the gut a point is in, so that a neighbouring loop is
    never taken for it; within that stretch the nearest point of the centreline counts.
    """
    organ = model.organ
    nearest, faces = model.wall.closest_point(positions_world)
    corners = model.vertices_world[organ.faces[faces]]
    rough = (_barycentric(nearest, corners) * organ.arc_length[organ.faces[faces]]).sum(axis=1)
    reach = 2.0 * organ.radius[organ.faces[faces]].max(axis=1)
    line = transform_points(model.T_world_patient, organ.centerline.points)
    arc_length = np.empty(len(positions_world))
    for index, (position, s, span) in enumerate(zip(positions_world, rough, reach, strict=True)):
        low, high = np.searchsorted(organ.centerline.arc_length, [s - span, s + span])
        low, high = min(low, len(line) - 2), max(high, low + 2)
        arc_length[index] = _project(
            position, line[low:high], organ.centerline.arc_length[low:high]
        )
    label = face_label(organ.label, organ.faces)[faces]
    return arc_length, np.array(organ.label_names, object)[label]


def _barycentric(
    points: Float[np.ndarray, "n 3"], corners: Float[np.ndarray, "n 3 3"]
) -> Float[np.ndarray, "n 3"]:
    """Weights of the corners of triangles that points lie in: areas opposite the corners."""
    to_corners = corners - points[:, None]
    areas = np.linalg.norm(
        np.cross(np.roll(to_corners, -1, axis=1), np.roll(to_corners, 1, axis=1)), axis=-1
    )
    return areas / np.maximum(areas.sum(axis=1, keepdims=True), 1e-30)


def _project(
    point: Float[np.ndarray, " 3"], line: Float[np.ndarray, "n 3"], s: Float[np.ndarray, " n"]
) -> float:
    """Arc length of the point of a polyline nearest to a point."""
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

    buffer = pa.BufferOutputStream()
    pq.write_table(pa.table(dict(table.columns)), buffer, compression="zstd")
    write_bytes(path, buffer.getvalue().to_pybytes())


def read_table(path: Path) -> FrameTable:
    """Read a table.

    Raises:
        OSError: If the file cannot be read.
        ValueError: If it is no Parquet file (`pyarrow.ArrowInvalid`).
    """
    import pyarrow.parquet as pq

    table = pq.read_table(path)
    return FrameTable({n: table[n].to_numpy(zero_copy_only=False) for n in table.column_names})
