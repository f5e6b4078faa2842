"""`frames.parquet`: one row a frame, units in the column names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps._core import Wall
from vrcaps.actuation.magnet_controller import ControllerStatus
from vrcaps.files import write_bytes
from vrcaps.motion.run import Conditions, Instant, Run
from vrcaps.organ.surface import face_label
from vrcaps.transforms import (
    matrix_from_quaternion,
    quaternion_from_matrix,
    rotate_vectors,
    transform_from,
    transform_points,
)
from vrcaps.world.model import Coupling, Model, State
from vrcaps.world.moving_wall import MovingWall

if TYPE_CHECKING:
    from jaxtyping import Float

POSE_COLUMNS = ("x_m", "y_m", "z_m", "qw", "qx", "qy", "qz")
_LINEAR = tuple(f"capsule_v{axis}_m_per_s" for axis in "xyz")
_ANGULAR = tuple(f"capsule_w{axis}_rad_per_s" for axis in "xyz")


SIMULATED_COLUMNS = (
    "capsule_along_gut_m_per_s",
    *(f"contact_force_{axis}_n" for axis in "xyz"),
    *(f"contact_torque_{axis}_nm" for axis in "xyz"),
    *("normal_force_total_n", "friction_work_j", "contact_area_m2", "contact_depth_m"),
    *(f"commanded_force_{axis}_n" for axis in "xyz"),
    *(f"commanded_torque_{axis}_nm" for axis in "xyz"),
    "insufflation",
    *(f"patient_{name}" for name in POSE_COLUMNS),
    "mmc_phase",
)
"""Columns of a run by dynamics, beside those of every run."""

STEERED_COLUMNS = (
    *(f"magnet_{name}" for name in POSE_COLUMNS),
    *(f"flux_density_{axis}_t" for axis in "xyz"),
    *(f"magnetic_force_{axis}_n" for axis in "xyz"),
    *(f"magnetic_torque_{axis}_nm" for axis in "xyz"),
    *(f"required_force_{axis}_n" for axis in "xyz"),
    *("coupling_angle_rad", "coupling_distance_m", "position_error_m", "heading_error_rad"),
    *("magnet_limit", "coupling_lost"),
)
"""Columns of a run that a magnet steers; those of an arm's joints come after them."""

_TEXTS = ("segment", "magnet_limit", "coupling_lost")


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


def column_names(
    cameras: tuple[str, ...], *, simulated: bool = False, steered: bool = False
) -> tuple[str, ...]:
    """Names of all columns, in order.

    Args:
        cameras: Names of the capsule's cameras.
        simulated: Whether the capsule moved by dynamics.
        steered: Whether a magnet steered it.
    """
    poses = [f"{body}_{name}" for body in ("capsule", *cameras) for name in POSE_COLUMNS]
    clearances = [f"{body}_clearance_m" for body in ("capsule", *cameras)]
    columns = ("frame", "time_s", *poses, *_LINEAR, *_ANGULAR, "arc_length_m", "segment")
    physics = SIMULATED_COLUMNS if simulated else ()
    return (*columns, *clearances, "wall_at_rest", *physics, *(STEERED_COLUMNS if steered else ()))


class TableRows:
    """Rows of a run, gathered frame by frame."""

    def __init__(
        self, model: Model, before: FrameTable | None = None, wall: MovingWall | None = None
    ) -> None:
        """Begins a table, or goes on with the rows of an earlier one.

        Args:
            model: What is recorded.
            before: Rows of the frames before.
            wall: The model's wall, shared with others who need it in the same states.
        """
        self.model = model
        self._wall = wall or MovingWall(model)
        self._rows: list[dict[str, Any]] = []
        if before is not None:
            columns = before.columns
            self._rows = [{k: v[i] for k, v in columns.items()} for i in range(len(before))]

    def __len__(self) -> int:
        return len(self._rows)

    def add(self, instant: Instant, more: Mapping[str, float] | None = None) -> None:
        """Adds a frame: pose, velocity, where in the gut, how far from the wall as it is then.

        Args:
            instant: The frame.
            more: Further columns, the same in each row.
        """
        state, cameras = instant.state, self.model.device.cameras
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
        arc_length, segment = locate_in_gut(
            self.model, state.T_world_capsule[None, :3, 3], instant=instant, wall=wall
        )
        row |= {"arc_length_m": arc_length[0], "segment": segment[0]}
        places = np.array([T_world_body[:3, 3] for T_world_body in poses.values()])
        clearances = np.asarray(wall.signed_distance(places), float)
        row |= {f"{body}_clearance_m": d for body, d in zip(poses, clearances, strict=True)}
        row["wall_at_rest"] = state.vertices_world is None
        if instant.conditions is not None:
            row |= _simulated(self.model, state, instant.conditions, float(arc_length[0]))
        self._rows.append(row | dict(more or {}))

    def table(self) -> FrameTable:
        """All rows so far."""
        cameras = tuple(camera.name for camera in self.model.device.cameras)
        simulated = bool(self._rows) and SIMULATED_COLUMNS[0] in self._rows[0]
        names = column_names(cameras, simulated=simulated)
        more = [name for name in self._rows[0] if name not in names] if self._rows else []
        columns = {name: np.array([row[name] for row in self._rows]) for name in (*names, *more)}
        texts = {name: columns[name].astype(object) for name in _TEXTS if name in columns}
        return FrameTable(columns | texts)


def make_table(model: Model, run: Run) -> FrameTable:
    """Columns of a whole run."""
    rows = TableRows(model)
    for instant in run.instants():
        rows.add(instant)
    return rows.table()


def _simulated(
    model: Model, state: State, conditions: Conditions, arc_length: float
) -> dict[str, Any]:
    """Columns of a frame that was simulated."""
    contact = state.contact
    assert contact is not None
    line, pose = model.organ.centerline, conditions.T_world_patient
    tangent = np.array([np.interp(arc_length, line.arc_length, t) for t in line.frames[:, :, 2].T])
    along = rotate_vectors(pose, tangent) / np.linalg.norm(tangent)
    values = (
        float(along @ state.linear_velocity_world),
        *contact.force_world,
        *contact.torque_world,
        *(contact.normal_force_total, contact.friction_work, contact.area, contact.depth),
        *conditions.force_world,
        *conditions.torque_world,
        conditions.insufflation,
        *pose[:3, 3],
        *quaternion_from_matrix(pose[:3, :3]),
        conditions.phase,
    )
    row = dict(zip(SIMULATED_COLUMNS, values, strict=True))
    if conditions.controller_status is None or state.coupling is None:
        return row
    return row | _steered(state.coupling, conditions.controller_status)


def _steered(coupling: Coupling, status: ControllerStatus) -> dict[str, Any]:
    """Columns of a frame in which a magnet steered."""
    actuator = status.actuator
    values = (
        *actuator.T_world_magnet[:3, 3],
        *quaternion_from_matrix(actuator.T_world_magnet[:3, :3]),
        *coupling.flux_density_world,
        *coupling.force_world,
        *coupling.torque_world,
        *status.required_force,
        *(coupling.angle, coupling.distance),
        *(float(np.linalg.norm(status.position_error)), status.heading_error),
        *(actuator.limit, status.lost),
    )
    row = dict(zip(STEERED_COLUMNS, values, strict=True))
    return row | {f"joint_{k}_rad": angle for k, angle in enumerate(actuator.joint_angles, start=1)}


def locate_in_gut(
    model: Model,
    positions_world: Float[np.ndarray, "n 3"],
    *,
    instant: Instant | None = None,
    wall: Wall | None = None,
) -> tuple[Float[np.ndarray, " n"], np.ndarray]:
    """Arc length [m] and segment name of points in the lumen.

    The nearest wall says which stretch of the gut a point is in, so that a neighbouring loop is
    never taken for it; within that stretch the nearest point of the centreline counts.

    Args:
        model: The lumen.
        positions_world: The points.
        instant: How wall and patient lie; None: at rest, as in the model.
        wall: The wall then; None: at rest.
    """
    organ, pose, vertices = model.organ, model.T_world_patient, model.vertices_world
    if instant is not None and instant.conditions is not None:
        pose = instant.conditions.T_world_patient
    if instant is not None and instant.state.vertices_world is not None:
        vertices = instant.state.vertices_world
    nearest, faces = (wall or model.wall).closest_point(positions_world)
    weights = _barycentric(nearest, vertices[organ.faces[faces]])
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
