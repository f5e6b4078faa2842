"""Worlds of an environment: patients, capsules, centerlines, and the state after the last step."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.transforms import invert
from vrcaps.core.units import CM
from vrcaps.env.course import Course
from vrcaps.world.batch import WorldBatch
from vrcaps.world.model import posture_transform

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.capsule.device import Device
    from vrcaps.env.memory import Memory
    from vrcaps.env.patients import Patient, Patients
    from vrcaps.world.model import Model
    from vrcaps.world.world import World

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
