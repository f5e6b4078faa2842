"""State observation: pose, velocity and contact of the capsule, the magnet's pose, and the time."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from vrcaps.config.fields import check_fields
from vrcaps.core.units import CM, MM
from vrcaps.env.parts import EnvView, Observation
from vrcaps.sensors.tracking import CapsuleTracker, TrackingSensors, check_locatable

if TYPE_CHECKING:
    from jaxtyping import Float


_LIMIT = 10.0
_POSITION = 10.0 * CM
_VELOCITY = 20.0 * MM
_FORCE = 0.1
_LOCATED = "state/located"


@dataclass(frozen=True)
class StateObservation(Observation):
    """Measurements of a tracker and a force sensor, in the world frame, as 19 values.

    - position of the capsule relative to the organ's center [0.1 m] (3)
    - its rotation: the x and z axes of the capsule (6)
    - its velocity [20 mm/s] (3) and angular velocity [1 rad/s] (3)
    - mean contact force [0.1 N] (3)
    - elapsed fraction of the episode (1)

    With an external magnet, its position relative to the capsule [0.1 m] and the direction of its
    moment follow (6). Values are clipped to ±10.

    Attributes:
        pose: Source of pose, velocities and contact force: `true` values, or `located`, estimated
            from `sensors`.
        sensors: Sensors in the capsule and under the patient, for a located pose. They are read
            once per control period.
    """

    pose: Literal["true", "located"] = "true"
    sensors: TrackingSensors = field(default_factory=TrackingSensors)

    kind: ClassVar[str] = "state"

    def __post_init__(self) -> None:
        check_fields(self)

    def space(self, view: EnvView) -> Any:
        """Observation space: values from −10 to 10."""
        from gymnasium import spaces

        count = 19 + (6 if "magnet/T" in view.memory else 0)
        return spaces.Box(-_LIMIT, _LIMIT, (count,), np.float32)

    def names(self, view: EnvView) -> tuple[str, ...]:
        """Name of each value, with its unit in brackets."""
        stems = {"position": "0.1 m", "axis_x": "1", "axis_z": "1", "velocity": "20 mm/s"}
        stems |= {"angular_velocity": "rad/s", "contact_force": "0.1 N"}
        magnet = {"magnet_offset": "0.1 m", "magnet_moment": "1"}
        names = (*_with_axes(stems), "time [1/episode_time]")
        return names + (_with_axes(magnet) if "magnet/T" in view.memory else ())

    def allocate(self, view: EnvView) -> None:
        """Allocate the center of each organ, and the localization.

        Raises:
            InputError: If the pose is located, but the capsule has no magnet for localization.
        """
        view.memory.allocate("state/center", (3,))
        if self.pose == "located":
            view.objects[_LOCATED] = LocatedCapsules(view, self.sensors)

    def begin(self, view: EnvView, index: int, rng: np.random.Generator) -> None:
        """Compute the center of the organ."""
        vertices = view.patient(index).model.vertices_world
        center = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
        view.memory["state/center"][index] = center
        if self.pose == "located":
            view.objects[_LOCATED].begin(index, rng)

    def observe(self, view: EnvView) -> Float[np.ndarray, "n k"]:
        """Return the values of all worlds."""
        s, memory = view, view.memory
        T, velocity, force = s.T_world_capsule, s.velocity_world, s.contact_force_world
        if self.pose == "located":
            located = view.objects[_LOCATED]
            located.read()
            T, velocity = located.Ts_world_capsule, located.velocity_world
            force = located.contact_force_world
        parts = [
            (T[:, :3, 3] - memory["state/center"]) / _POSITION,
            T[:, :3, 0],
            T[:, :3, 2],
            velocity[:, 0] / _VELOCITY,
            velocity[:, 1],
            force / _FORCE,
            s.time[:, None] / s.episode_time,
        ]
        if "magnet/T" in memory:
            T_magnet = memory["magnet/T"]
            parts += [(T_magnet[:, :3, 3] - T[:, :3, 3]) / _POSITION, T_magnet[:, :3, 2]]
        return np.concatenate(parts, axis=1).clip(-_LIMIT, _LIMIT).astype(np.float32)


def _with_axes(stems: dict[str, str]) -> tuple[str, ...]:
    """Names of the components of vectors with their units."""
    return tuple(f"{stem}_{axis} [{unit}]" for stem, unit in stems.items() for axis in "xyz")


class LocatedCapsules:
    """A filter for each world, which reads its IMU and Hall sensors once per control period.

    Its state is part of the environment's memory.

    Attributes:
        Ts_world_capsule: Estimated poses.
        velocity_world: Velocities [m/s], and angular velocities [rad/s] from the gyroscopes.
        contact_force_world: Forces of the wall on the capsules' sides [N].
    """

    def __init__(self, view: EnvView, sensors: TrackingSensors) -> None:
        """Allocate buffers.

        Raises:
            InputError: If the capsule does not contain exactly one magnet for localization.
        """
        check_locatable(view.device)
        self._view, self._sensors = view, sensors
        memory = view.memory
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
        for index, world in enumerate(self._view.batch.worlds):
            tracker, sources = self._tracker(index), world.sources
            tracker.restore(self._saved[index], sources)
            tracker.read(world, sources)
            self._saved[index] = tracker.to_array()
            self.Ts_world_capsule[index] = tracker.T_world_capsule
            self.velocity_world[index] = tracker.velocity_world
            self.contact_force_world[index] = tracker.contact_force_world

    def _tracker(self, index: int) -> CapsuleTracker:
        """Tracker of a world's patient and seed; its state is that of its last use."""
        view = self._view
        key = (int(self._seed[index]), view.patient_index(index))
        current = self._trackers.get(index)
        if current is None or current[0] != key:
            model, T = view.batch.worlds[index].model, view.T_world_capsule[index].copy()
            period = view.control_period
            tracker = CapsuleTracker(model, self._sensors, T, period=period, seed=key[0])
            current = self._trackers[index] = (key, tracker)
        return current[1]
