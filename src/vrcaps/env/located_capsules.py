"""Localized capsules: poses of the capsules of all worlds, estimated from their sensors."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vrcaps.sensors.tracking import CapsuleTracker, TrackingSensors, check_locatable

if TYPE_CHECKING:
    from vrcaps.env.simulation import Simulation


class LocatedCapsules:
    """A filter for each world, which reads its IMU and Hall sensors once per control period.

    Its state is part of the simulation's memory.

    Attributes:
        Ts_world_capsule: Estimated poses.
        velocity_world: Velocities [m/s], and angular velocities [rad/s] from the gyroscopes.
        contact_force_world: Forces of the wall on the capsules' sides [N].
    """

    def __init__(self, simulation: Simulation, sensors: TrackingSensors) -> None:
        """Allocate buffers.

        Raises:
            InputError: If the capsule does not contain exactly one magnet for localization.
        """
        check_locatable(simulation.device)
        self._simulation, self._sensors = simulation, sensors
        memory = simulation.memory
        self._seed = memory.allocate("located/seed", dtype=np.int64)
        self._saved = memory.allocate("located/filter", (CapsuleTracker.size,))
        self.Ts_world_capsule = memory.allocate("located/T", (4, 4))
        self.velocity_world = memory.allocate("located/velocity", (2, 3))
        self.contact_force_world = memory.allocate("located/force", (3,))
        self._trackers: dict[int, tuple[tuple[int, int], CapsuleTracker]] = {}

    def begin(self, index: int, rng: np.random.Generator) -> None:
        """Start the localization of the capsule of one world, near its true pose."""
        self._seed[index] = rng.integers(2**31)
        self._trackers.pop(index, None)
        self._saved[index] = self._tracker(index).to_array()

    def read(self) -> None:
        """Read the sensors of all worlds that have advanced since the last reading."""
        for index, world in enumerate(self._simulation.worlds):
            tracker, sources = self._tracker(index), world.sources
            tracker.restore(self._saved[index], sources)
            tracker.read(world, sources)
            self._saved[index] = tracker.to_array()
            self.Ts_world_capsule[index] = tracker.T_world_capsule
            self.velocity_world[index] = tracker.velocity_world
            self.contact_force_world[index] = tracker.contact_force_world

    def _tracker(self, index: int) -> CapsuleTracker:
        """Tracker of a world's patient and seed; its state is that of its last use."""
        s = self._simulation
        key = (int(self._seed[index]), s.patient_number(index))
        kept = self._trackers.get(index)
        if kept is None or kept[0] != key:
            model, T = s.worlds[index].model, s.T_world_capsule[index].copy()
            period = s.settings.control_period
            tracker = CapsuleTracker(model, self._sensors, T, period=period, seed=key[0])
            kept = self._trackers[index] = (key, tracker)
        return kept[1]
