"""Parallel worlds of an environment: their reset, steps and camera views."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vrcaps.capsule.device_file import device_of
from vrcaps.core.transforms import invert
from vrcaps.core.units import CM
from vrcaps.env.course import Course
from vrcaps.env.located_capsules import LocatedCapsules
from vrcaps.env.memory import Memory
from vrcaps.env.patient import Patient, Patients
from vrcaps.env.randomization import FACTORS, varied_device, varied_tissue
from vrcaps.env.snapshot import WorldSnapshot
from vrcaps.env.views import Views
from vrcaps.metrics.coverage import CoverageLevel
from vrcaps.metrics.point_coverage import POINT_LEVELS, mark_points
from vrcaps.world.batch import WorldBatch
from vrcaps.world.control import Control
from vrcaps.world.model import State, posture_transform
from vrcaps.world.world import World

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

    from vrcaps.env.settings import EnvSettings
    from vrcaps.world.model import Model

_NEARBY = 3.0 * CM
"""Maximum change of the capsule's arc length per step, for the search of its position."""


class Simulation:
    """Parallel worlds. Arrays have a row for each world and hold the state after the last step.

    Attributes:
        settings: Settings of the environment.
        device: The nominal capsule.
        devices: The capsule of each world, after randomization.
        T_patient_world: Transform from the world to the frame in which walls are stored.
        memory: State that changes from step to step; part of a snapshot.
        worlds: The worlds; each is replaced at a reset.
        time: Time since the start of the episode [s].
        arc_length: Position of the capsule along the centerline [m].
        fraction: Fraction of the whole seen so far at each of `POINT_LEVELS`.
        gain: Fraction that was seen for the first time in the last step.
        cells: Visible fraction of the whole so far in each cell of the map.
        cell_area: Fraction of the whole that lies in each cell.
        cell_center: Centroid of each cell's part of the wall at rest [m]; 0 for empty cells.
        course: Centerlines.
        views: Images.
        effects_seed: Seed of the camera effects of each world.
        located: Localized capsules; None if no observation needs them.
        T_world_capsule: Poses of the capsules.
        velocity_world: Their velocities [m/s] and angular velocities [rad/s].
        contact_force_world: Mean force of the wall on each in the last step [N].
        normal_force_total: Mean sum of the magnitudes of the normal forces [N].
        is_outside: Whether a capsule has left the lumen, which is a fault of the simulation.
        failure: Reason why a world could not be stepped; empty without failure.
    """

    def __init__(
        self, settings: EnvSettings, num_worlds: int, *, with_textures: bool = False
    ) -> None:
        """Allocate buffers; worlds are created by `reset`.

        Args:
            settings: Settings of the environment.
            num_worlds: Number of worlds.
            with_textures: Whether walls have textures even if no observation needs them.

        Raises:
            UnknownNameError: If the capsule has no camera that an observation names.
        """
        self.settings, self.num_worlds = settings, num_worlds
        self.T_patient_world = invert(posture_transform(settings.posture))
        self.device = device_of(settings.capsule)
        with_textures |= any(observation.needs_textures for observation in settings.observations)
        self.patients = Patients(settings, self.device, with_textures=with_textures)
        self.worlds: list[World] = []
        self.memory = memory = Memory(num_worlds)
        rows, columns = settings.grid
        self.time = memory.allocate("time")
        self.arc_length = memory.allocate("arc_length")
        self.fraction = memory.allocate("fraction", (len(POINT_LEVELS),))
        self.gain = memory.allocate("gain", (len(POINT_LEVELS),))
        self.cells = memory.allocate("cells", (rows * columns,))
        self.cell_area = memory.allocate("cell_area", (rows * columns,))
        self.cell_center = memory.allocate("cell_center", (rows * columns, 3))
        self.course = Course(memory)
        self._patient = memory.allocate("patient", dtype=np.int64, fill=-1)
        self.flags: list[np.ndarray] = [np.zeros(0, np.uint8)] * num_worlds
        self.T_world_capsule = memory.allocate("T_world_capsule", (4, 4))
        self.T_world_capsule[:] = np.eye(4)
        self.velocity_world = memory.allocate("velocity_world", (2, 3))
        self.contact_force_world = memory.allocate("contact_force_world", (3,))
        self.normal_force_total = memory.allocate("normal_force_total")
        self.is_outside = memory.allocate("is_outside", dtype=bool)
        self._start = memory.allocate("start", (4, 4))
        self._factors = memory.allocate("randomization/factors", (len(FACTORS),), fill=1.0)
        self.effects_seed = memory.allocate("randomization/seed", dtype=np.int64)
        self.devices = [self.device] * num_worlds
        self.failure = [""] * num_worlds
        self.views = Views(self)
        self.located: LocatedCapsules | None = None
        settings.actuation.allocate(self)
        settings.task.allocate(self)
        for observation in settings.observations:
            observation.allocate(self)

    def patient(self, index: int) -> Patient:
        """Return the patient of a world."""
        return self.patients[self.patient_number(index)]

    def patient_number(self, index: int) -> int:
        """Return the index of a world's organ in the settings."""
        return int(self._patient[index])

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

    def reset(self, index: int, rng: np.random.Generator, number: int | None = None) -> None:
        """Start an episode in one world.

        Args:
            index: Index of the world.
            rng: Random generator.
            number: Index of the patient; None draws one.

        Raises:
            InputError: If the organ cannot be created, or the capsule does not fit in it.
        """
        settings = self.settings
        drawn = rng.integers(len(self.patients))
        model = self._enter(index, int(drawn if number is None else number))
        start, self.arc_length[index] = settings.start.draw(model, rng)
        self._start[index] = start.T_world_capsule
        self._factors[index], self.effects_seed[index] = settings.randomization.draw(rng)
        world = self._make_world(index, int(rng.integers(2**31)))
        if settings.start.settle:
            world.step(Control(), settings.start.settle)
        self._begin(index, rng)

    def follow(self, index: int, world: World, arc_length: float, rng: np.random.Generator) -> None:
        """Start an episode in a world that is stepped externally and updated by `arrive`.

        Args:
            index: Index of the world.
            world: World of the first of the settings' patients.
            arc_length: Position of its capsule along the centerline [m].
            rng: Random generator.

        Raises:
            InputError: If the actuation cannot start there.
        """
        self._enter(index, 0)
        self._start[index], self.arc_length[index] = world.T_world_capsule, arc_length
        self.settings.actuation.begin(self, index, world.state)
        self._put(index, world)
        self._begin(index, rng)

    def _enter(self, index: int, number: int) -> Model:
        """Set the patient of one world."""
        self._patient[index] = number
        patient = self.patient(index)
        self.course.begin(index, patient.model)
        self.cell_area[index], self.cell_center[index] = patient.cell_area, patient.cell_center
        return patient.model

    def _begin(self, index: int, rng: np.random.Generator) -> None:
        """Reset coverage, task and observations of one world."""
        settings = self.settings
        self.flags[index] = np.zeros(len(self.patient(index).points), np.uint8)
        for array in (self.time, self.fraction, self.gain, self.cells):
            array[index] = 0.0
        self.failure[index] = ""
        self.views.begin(index)
        self._read(np.array([index]))
        settings.task.begin(self, index, rng)
        for observation in settings.observations:
            observation.begin(self, index, rng)

    def _make_world(self, index: int, seed: int) -> World:
        """Create a world at its start pose, with the sources of the actuation."""
        settings, start = self.settings, State(0.0, self._start[index].copy())
        sources = settings.actuation.begin(self, index, start)
        model, factors = self.patient(index).model, self._factors[index]
        self.devices[index] = device = varied_device(self.device, factors)
        world = World(
            model if device is self.device else model.with_device(device),
            varied_tissue(settings.tissue, factors),
            start,
            dynamics=settings.dynamics,
            substep=settings.substep,
            seed=seed,
            sources=sources,
        )
        self._put(index, world)
        return world

    def _put(self, index: int, world: World) -> None:
        if not self.worlds:
            self.worlds = [world] * self.num_worlds
        self.worlds[index] = world

    def snapshot(self, index: int, generator: str = "", is_over: bool = False) -> WorldSnapshot:
        """Return the full state of one world.

        Args:
            index: Index of the world.
            generator: State of its random generator, as JSON.
            is_over: Whether its episode is over.
        """
        return WorldSnapshot(
            self.worlds[index].snapshot(),
            self.memory.row(index),
            self.flags[index].copy(),
            self.failure[index],
            generator,
            is_over,
        )

    def restore(self, index: int, saved: WorldSnapshot) -> None:
        """Restore a snapshot of one world.

        Raises:
            InputError: If it is of another environment, or damaged.
        """
        self.memory.set_row(index, saved.memory)
        self._make_world(index, saved.world.seed).restore(saved.world)
        self.flags[index], self.failure[index] = saved.flags.copy(), saved.failure
        self.views.expire(np.array([index]))
        # Repeated, since the creation of the world has changed some of it.
        self.memory.set_row(index, saved.memory)

    def step(self, actions: np.ndarray, active: Bool[np.ndarray, " n"]) -> None:
        """Advance the active worlds by one control period.

        A world that cannot be stepped keeps its state and reports the reason in `failure`.
        """
        settings, numbers = self.settings, np.flatnonzero(active)
        controls = settings.actuation.controls(self, actions, numbers)
        worlds = [self.worlds[index] for index in numbers]
        failures = WorldBatch(worlds).try_step(controls, settings.control_period)
        for place, failure in failures.items():
            self.failure[numbers[place]] = failure
        self.arrive(numbers, settings.control_period)

    def arrive(self, numbers: np.ndarray, duration: float) -> None:
        """Update the state after the given worlds have advanced by a time [s]."""
        self.time[numbers] += duration
        self._read(numbers)
        self.settings.task.update(self, numbers)

    def _read(self, numbers: np.ndarray) -> None:
        """Update all arrays from some of the worlds."""
        batch = WorldBatch([self.worlds[index] for index in numbers])
        state = batch.state()
        self.T_world_capsule[numbers] = state.Ts_world_capsule
        self.velocity_world[numbers, 0] = state.linear_velocity_world
        self.velocity_world[numbers, 1] = state.angular_velocity_world
        self.contact_force_world[numbers] = state.contact_force_world
        self.normal_force_total[numbers] = state.normal_force_total
        self.is_outside[numbers] = ~batch.are_inside()
        places, before = self.T_world_capsule[numbers, :3, 3], self.arc_length[numbers]
        self.arc_length[numbers] = self.course.nearest(numbers, places, before, _NEARBY)
        self.views.expire(numbers)
        self._look(numbers)

    def _look(self, numbers: np.ndarray) -> None:
        """Mark the wall points that the cameras see."""
        self.gain[numbers] = 0.0
        lenses = np.array([id(self.devices[k].cameras) for k in numbers])
        for lens in set(lenses.tolist()):
            self._look_alike(numbers[lenses == lens])
        self.fraction[numbers] += self.gain[numbers]

    def _look_alike(self, numbers: np.ndarray) -> None:
        """Mark the wall points seen in worlds with identical cameras."""
        cells, walls = self.cells[numbers], WorldBatch([self.worlds[k] for k in numbers]).walls()
        for camera in self.devices[numbers[0]].cameras:
            self.gain[numbers] += mark_points(
                walls,
                [self.patient(k).points for k in numbers],
                camera,
                self.T_patient_world @ self.T_world_capsule[numbers] @ camera.T_capsule_camera,
                [self.flags[k] for k in numbers],
                cells,
                self.settings.criteria,
            )
        self.cells[numbers] = cells
