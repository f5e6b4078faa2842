"""State observation: pose, velocity and contact of the capsule, the magnet's pose, and the time."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from vrcaps.config.limits import check_fields
from vrcaps.core.units import CM, MM
from vrcaps.env.located_capsules import LocatedCapsules
from vrcaps.env.observations.observation import Observation
from vrcaps.sensors.tracking import TrackingSensors

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.env.simulation import Simulation

_LIMIT = 10.0
_POSITION = 10.0 * CM
_VELOCITY = 20.0 * MM
_FORCE = 0.1


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
    name: ClassVar[str] = "state"
    needs_textures: ClassVar[bool] = False

    def __post_init__(self) -> None:
        check_fields(self)

    def space(self, simulation: Simulation) -> Any:
        """Observation space: values from −10 to 10."""
        from gymnasium import spaces

        count = 19 + (6 if "magnet/T" in simulation.memory else 0)
        return spaces.Box(-_LIMIT, _LIMIT, (count,), np.float32)

    def allocate(self, simulation: Simulation) -> None:
        """Allocate the center of each organ, and the localization.

        Raises:
            InputError: If the pose is located, but the capsule has no magnet for localization.
        """
        simulation.memory.allocate("state/center", (3,))
        if self.pose == "located":
            simulation.located = LocatedCapsules(simulation, self.sensors)

    def begin(self, simulation: Simulation, index: int, rng: np.random.Generator) -> None:
        """Compute the center of the organ."""
        vertices = simulation.patient(index).model.vertices_world
        center = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
        simulation.memory["state/center"][index] = center
        if simulation.located is not None:
            simulation.located.begin(index, rng)

    def observe(self, simulation: Simulation) -> Float[np.ndarray, "n k"]:
        """Return the values of all worlds."""
        s, memory = simulation, simulation.memory
        T, velocity, force = s.T_world_capsule, s.velocity_world, s.contact_force_world
        if s.located is not None:
            s.located.read()
            T, velocity = s.located.Ts_world_capsule, s.located.velocity_world
            force = s.located.contact_force_world
        parts = [
            (T[:, :3, 3] - memory["state/center"]) / _POSITION,
            T[:, :3, 0],
            T[:, :3, 2],
            velocity[:, 0] / _VELOCITY,
            velocity[:, 1],
            force / _FORCE,
            s.time[:, None] / s.settings.episode_time,
        ]
        if "magnet/T" in memory:
            T_magnet = memory["magnet/T"]
            parts += [(T_magnet[:, :3, 3] - T[:, :3, 3]) / _POSITION, T_magnet[:, :3, 2]]
        return np.concatenate(parts, axis=1).clip(-_LIMIT, _LIMIT).astype(np.float32)
