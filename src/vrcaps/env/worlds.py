"""Worlds of an environment: patients, capsules, centerlines, and the state after the last step.

Their memory holds the state of task, actuation and observations between steps; their coverage is
the seen part of each wall: total, gain of a step, and its map.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.core.errors import InputError
from vrcaps.core.geometry import invert, rotate_vectors, transform_points
from vrcaps.core.units import CM
from vrcaps.metrics.coverage import CoverageCriteria, CoverageLevel
from vrcaps.metrics.point_coverage import POINT_LEVELS, mark_points
from vrcaps.organ.surface import interpolate
from vrcaps.world.batch import WorldBatch
from vrcaps.world.model import posture_transform

if TYPE_CHECKING:
    from jaxtyping import Float, Int

    from vrcaps.capsule.device import Device
    from vrcaps.env.patients import Patient, Patients
    from vrcaps.world.model import Model
    from vrcaps.world.world import World


class Memory:
    """Named arrays with a row for each world; saved and restored row by row.

    All state that changes during an episode is stored here, so that a snapshot of an environment is
    complete without knowledge of its parts.

    Example:
        >>> best = memory.allocate("coverage/best")
        >>> row = memory.row(3)

    Attributes:
        num_worlds: Number of worlds.
    """

    def __init__(self, num_worlds: int) -> None:
        self.num_worlds = num_worlds
        self._arrays: dict[str, np.ndarray] = {}

    def allocate(
        self, name: str, shape: Sequence[int] = (), dtype: Any = float, fill: float = 0
    ) -> np.ndarray:
        """Allocate an array [num_worlds, *shape] filled with one value."""
        if name in self._arrays:
            raise InputError(f"Buffer {name!r} exists already. Choose another name.")
        self._arrays[name] = np.full((self.num_worlds, *shape), fill, dtype)
        return self._arrays[name]

    def __getitem__(self, name: str) -> np.ndarray:
        return self._arrays[name]

    def __contains__(self, name: str) -> bool:
        return name in self._arrays

    def row(self, index: int) -> dict[str, np.ndarray]:
        """Return a copy of the rows of one world."""
        return {name: array[index].copy() for name, array in self._arrays.items()}

    def set_row(self, index: int, row: dict[str, np.ndarray]) -> None:
        """Restore the rows of one world from `row`.

        Raises:
            InputError: If they are of another memory.
        """
        arrays = self._arrays
        fits = set(row) == set(arrays) and all(
            np.shape(row[name]) == array.shape[1:] for name, array in arrays.items()
        )
        if not fits:
            raise InputError(
                "The snapshot is of another environment. Give one of an environment with the same "
                "settings."
            )
        for name, value in row.items():
            arrays[name][index] = value


_NEARBY = 3.0 * CM
"""Maximum change of the capsule's arc length per step, for the search of its position."""


class EnvWorlds:
    """Batch of worlds with their patients. Arrays have a row for each world.

    Attributes:
        memory: State that changes from step to step; part of a snapshot.
        patients: Patients, one of which is in each world.
        device: The nominal capsule.
        devices: The capsule of each world, after randomization.
        T_patient_world: Transform from the world to the frame in which walls are stored.
        batch: The worlds; each is replaced at a reset.
        course: Centerlines.
        time: Time since the start of the episode [s].
        arc_length: Position of the capsule along the centerline [m].
        T_world_capsule: Poses of the capsules.
        velocity_world: Their velocities [m/s] and angular velocities [rad/s].
        contact_force_world: Mean force of the wall on each in the last step [N].
        normal_force_total: Mean sum of the magnitudes of the normal forces [N].
        is_outside: Whether a capsule has left the lumen, which is a fault of the simulation.
        effects_seed: Seed of the camera effects of each world.
    """

    def __init__(self, memory: Memory, patients: Patients, posture: str) -> None:
        """Allocate arrays; worlds are added by `put`."""
        self.memory, self.patients, self.device = memory, patients, patients.device
        self.devices: list[Device] = [patients.device] * memory.num_worlds
        self.T_patient_world = invert(posture_transform(posture))
        self.batch: WorldBatch[World] = WorldBatch()
        self.course = Course(memory)
        self.time = memory.allocate("time")
        self.arc_length = memory.allocate("arc_length")
        self.T_world_capsule = memory.allocate("T_world_capsule", (4, 4))
        self.T_world_capsule[:] = np.eye(4)
        self.velocity_world = memory.allocate("velocity_world", (2, 3))
        self.contact_force_world = memory.allocate("contact_force_world", (3,))
        self.normal_force_total = memory.allocate("normal_force_total")
        self.is_outside = memory.allocate("is_outside", dtype=bool)
        self.effects_seed = memory.allocate("randomization/seed", dtype=np.int64)
        self._patient = memory.allocate("patient", dtype=np.int64, fill=-1)

    def patient(self, index: int) -> Patient:
        """Return the patient of a world."""
        return self.patients[self.patient_index(index)]

    def patient_index(self, index: int) -> int:
        """Return the index of a world's organ in the settings; -1 before its first episode."""
        return int(self._patient[index])

    def enter(self, index: int, patient: int) -> Model:
        """Set the index of the patient of one world; return its model."""
        self._patient[index] = patient
        model = self.patient(index).model
        self.course.begin(index, model)
        return model

    def put(self, index: int, world: World) -> None:
        """Replace one world."""
        if not self.batch.worlds:
            self.batch.worlds = [world] * self.memory.num_worlds
        self.batch.worlds[index] = world

    def T_patient_capsule(self, index: int | np.ndarray) -> Float[np.ndarray, "*m 4 4"]:
        """Pose of one capsule or of several in the frame in which their walls are stored."""
        return self.T_patient_world @ self.T_world_capsule[index]

    def read(self, indices: np.ndarray) -> None:
        """Update all arrays but the time from some of the worlds."""
        state = self.batch.state(indices)
        self.T_world_capsule[indices] = state.Ts_world_capsule
        self.velocity_world[indices, 0] = state.linear_velocity_world
        self.velocity_world[indices, 1] = state.angular_velocity_world
        self.contact_force_world[indices] = state.contact_force_world
        self.normal_force_total[indices] = state.normal_force_total
        self.is_outside[indices] = ~self.batch.are_inside(indices)
        points, before = self.T_world_capsule[indices, :3, 3], self.arc_length[indices]
        self.arc_length[indices] = self.course.nearest(indices, points, before, _NEARBY)


_SAMPLES = 512


@dataclass(frozen=True)
class CoursePoint:
    """A position on the centerline in each world, in the world frame.

    Attributes:
        point: The position [m].
        axes: Transverse axes and tangent there, as rows.
        radius: Distance from there to the nearest wall at rest [m].
    """

    point: Float[np.ndarray, "n 3"]
    axes: Float[np.ndarray, "n 3 3"]
    radius: Float[np.ndarray, " n"]


class Course:
    """Centerlines of the organs of all worlds.

    Attributes:
        length: Length of each centerline [m].
    """

    def __init__(self, memory: Memory) -> None:
        """Allocate the arrays in the memory."""
        self._samples = memory.allocate("course/samples", (_SAMPLES, 13))
        self.length = memory.allocate("course/length")

    def begin(self, index: int, model: Model) -> None:
        """Set the organ of one world."""
        line = model.organ.centerline
        points, frames, radius = interpolate(line, np.linspace(0.0, line.length, _SAMPLES))
        axes = rotate_vectors(model.T_world_patient, np.swapaxes(frames, 1, 2))
        self._samples[index, :, :3] = transform_points(model.T_world_patient, points)
        self._samples[index, :, 3:12] = axes.reshape(-1, 9)
        self._samples[index, :, 12] = radius
        self.length[index] = line.length

    def at(self, arc_length: Float[np.ndarray, " n"]) -> CoursePoint:
        """Evaluate the centerline at arc lengths [m], one per world, clamped to its ends.

        Points and radii are interpolated linearly; axes are those of the nearest sample.
        """
        position = (arc_length / self.length).clip(0.0, 1.0) * (_SAMPLES - 1)
        below = np.minimum(position.astype(int), _SAMPLES - 2)
        worlds, fraction = np.arange(len(below)), (position - below)[:, None]
        start, end = self._samples[worlds, below], self._samples[worlds, below + 1]
        point = start + fraction * (end - start)
        axes = np.where(fraction < 0.5, start, end)[:, 3:12]
        return CoursePoint(point[:, :3], axes.reshape(-1, 3, 3), point[:, 12])

    def nearest(
        self,
        indices: Int[np.ndarray, " m"],
        positions: Float[np.ndarray, "m 3"],
        arc_length: Float[np.ndarray, " m"],
        reach: float,
    ) -> Float[np.ndarray, " m"]:
        """Arc lengths [m] of the points on centerlines that are nearest to positions in the world.

        Args:
            indices: Indices of the worlds.
            positions: Position in each world [m].
            arc_length: Center of the search [m], since a neighboring loop of gut may be nearer.
            reach: Search distance along the gut [m].
        """
        points, length = self._samples[indices, :, :3], self.length[indices]
        step, worlds = length / (_SAMPLES - 1), np.arange(len(indices))
        offsets = positions[:, None] - points
        squares = np.einsum("nki,nki->nk", offsets, offsets)
        away = np.abs(step[:, None] * np.arange(_SAMPLES) - arc_length[:, None])
        best = np.where(away <= np.maximum(reach, step)[:, None], squares, np.inf).argmin(axis=1)
        chord = points[worlds, np.minimum(best + 1, _SAMPLES - 1)]
        chord = chord - points[worlds, np.maximum(best - 1, 0)]
        along = np.einsum("ni,ni->n", offsets[worlds, best], chord)
        along /= np.maximum(np.linalg.norm(chord, axis=1), 1e-12)
        return (best * step + along.clip(-step, step)).clip(0.0, length)


class Coverage:
    """Coverage so far; arrays have a row for each world.

    Attributes:
        fraction: Fraction of the whole seen so far at each of `POINT_LEVELS`.
        gain: Fraction that was seen for the first time in the last step.
        cells: Visible fraction of the whole so far in each cell of the map.
        cell_area: Fraction of the whole that lies in each cell.
        cell_center: Centroid of each cell's part of the wall at rest [m]; 0 for empty cells.
        flags: Levels at which each point of the wall was seen, as bits.
    """

    def __init__(
        self, worlds: EnvWorlds, grid: tuple[int, int], criteria: CoverageCriteria
    ) -> None:
        """Allocate arrays."""
        memory, num_cells = worlds.memory, grid[0] * grid[1]
        self._worlds, self._criteria = worlds, criteria
        self.fraction = memory.allocate("fraction", (len(POINT_LEVELS),))
        self.gain = memory.allocate("gain", (len(POINT_LEVELS),))
        self.cells = memory.allocate("cells", (num_cells,))
        self.cell_area = memory.allocate("cell_area", (num_cells,))
        self.cell_center = memory.allocate("cell_center", (num_cells, 3))
        self.flags: list[np.ndarray] = [np.zeros(0, np.uint8)] * memory.num_worlds

    def seen(self, level: CoverageLevel) -> Float[np.ndarray, " n"]:
        """Return the fraction of the whole seen so far at one level."""
        return self.fraction[:, POINT_LEVELS.index(level)]

    @property
    def cell_fraction(self) -> Float[np.ndarray, "n c"]:
        """Fraction of each cell's area that was visible so far; 1 for cells without wall."""
        ones = np.ones_like(self.cells)
        fraction = np.divide(self.cells, self.cell_area, out=ones, where=self.cell_area > 0.0)
        return fraction.clip(0.0, 1.0)

    @property
    def unseen_cells(self) -> Float[np.ndarray, "n c"]:
        """Fraction of the whole in each cell of the map that was not visible yet."""
        return np.maximum(self.cell_area - self.cells, 0.0)

    def begin(self, index: int) -> None:
        """Start an episode in one world, with an unseen wall."""
        patient = self._worlds.patient(index)
        self.cell_area[index], self.cell_center[index] = patient.cell_area, patient.cell_center
        self.flags[index] = np.zeros(len(patient.points), np.uint8)
        for array in (self.fraction, self.gain, self.cells):
            array[index] = 0.0

    def update(self, indices: np.ndarray) -> None:
        """Mark the wall points that the cameras of some worlds see."""
        self.gain[indices] = 0.0
        lenses = np.array([id(self._worlds.devices[k].cameras) for k in indices])
        for lens in set(lenses.tolist()):
            self._update_alike(indices[lenses == lens])
        self.fraction[indices] += self.gain[indices]

    def _update_alike(self, indices: np.ndarray) -> None:
        """Mark the wall points seen in worlds with identical cameras."""
        worlds, cells = self._worlds, self.cells[indices]
        walls, poses = worlds.batch.walls(indices), worlds.T_patient_capsule(indices)
        for camera in worlds.devices[indices[0]].cameras:
            self.gain[indices] += mark_points(
                walls,
                [worlds.patient(k).points for k in indices],
                camera,
                poses @ camera.T_capsule_camera,
                [self.flags[k] for k in indices],
                cells,
                self._criteria,
            )
        self.cells[indices] = cells
