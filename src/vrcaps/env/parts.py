"""Parts of an environment: base classes and registries of tasks, rewards, observations, actuations.

A part is a frozen dataclass with a class variable `kind`. It sees the worlds through an `EnvView`
and keeps its own state in `view.memory`, so that a snapshot of an environment is complete.

Example:
    >>> @vrcaps.env.REWARDS.register
    ... @dataclass(frozen=True)
    ... class Slowness(vrcaps.env.Reward):
    ...     kind: ClassVar[str] = "slowness"
    ...
    ...     def term(self, view):
    ...         return -np.linalg.norm(view.velocity_world[:, 0], axis=1)
    >>> gymnasium.make("vrcaps.env:Coverage-v0", rewards=("area-gain", Slowness(weight=0.1)))
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from vrcaps.config.convert import register_family
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.registry import Registry

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Bool, Float

    from vrcaps.capsule.device import Device
    from vrcaps.env.cameras import CameraImages
    from vrcaps.env.patients import Patient
    from vrcaps.env.worlds import Course, Coverage, EnvWorlds, Memory
    from vrcaps.magnet.sources import Source
    from vrcaps.metrics.coverage import CoverageCriteria
    from vrcaps.world.batch import WorldBatch
    from vrcaps.world.control import Control
    from vrcaps.world.model import State
    from vrcaps.world.world import World


@dataclass(frozen=True, eq=False)
class EnvView:
    """View of the worlds of an environment; arrays are read-only and have a row for each world.

    Attributes:
        task: Task of the environment.
        actuation: Its actuation.
        control_period: Time between actions [s].
        episode_time: Maximum duration of an episode [s].
        dynamics: `quasi-static` or `physics`.
        relaxation_time: Time constant with which contents damp a capsule's momentum [s].
        criteria: Criteria for a part of the wall to count as seen.
        grid: Numbers of cells of the map of the wall, along the gut and around it.
        memory: State of the parts, which each writes under its own names.
        coverage: Coverage of the wall.
        cameras: Images.
        time: Time since the start of the episode [s].
        arc_length: Position of the capsule along the centerline [m].
        T_world_capsule: Poses of the capsules.
        velocity_world: Their velocities [m/s] and angular velocities [rad/s].
        contact_force_world: Mean force of the wall on each in the last step [N].
        normal_force_total: Mean sum of the magnitudes of the normal forces [N].
        objects: Objects that parts can recreate from their memory, by name.
    """

    task: Task
    actuation: Actuation
    control_period: float
    episode_time: float
    dynamics: str
    relaxation_time: float
    criteria: CoverageCriteria
    grid: tuple[int, int]
    memory: Memory
    coverage: Coverage
    cameras: CameraImages
    time: Float[np.ndarray, " n"]
    arc_length: Float[np.ndarray, " n"]
    T_world_capsule: Float[np.ndarray, "n 4 4"]
    velocity_world: Float[np.ndarray, "n 2 3"]
    contact_force_world: Float[np.ndarray, "n 3"]
    normal_force_total: Float[np.ndarray, " n"]
    _worlds: EnvWorlds
    objects: dict[str, Any] = field(default_factory=dict)

    @property
    def num_worlds(self) -> int:
        """Number of worlds."""
        return len(self.time)

    @property
    def device(self) -> Device:
        """The nominal capsule."""
        return self._worlds.device

    @property
    def T_patient_world(self) -> Float[np.ndarray, "4 4"]:
        """Transform from the world to the frame in which walls are stored."""
        return self._worlds.T_patient_world

    @property
    def batch(self) -> WorldBatch[World]:
        """The worlds; each is replaced at a reset."""
        return self._worlds.batch

    @property
    def course(self) -> Course:
        """Centerlines."""
        return self._worlds.course

    def patient(self, index: int) -> Patient:
        """Return the patient of a world."""
        return self._worlds.patient(index)

    def patient_index(self, index: int) -> int:
        """Return the index of a world's organ in the settings; -1 before its first episode."""
        return self._worlds.patient_index(index)


@dataclass(frozen=True)
class Task:
    """Task of an agent. Arrays have a row for each world."""

    kind: ClassVar[str]

    @property
    def rewards(self) -> tuple[Reward, ...]:
        """Default rewards."""
        return ()

    @property
    def defaults(self) -> dict[str, Any]:
        """Default settings by name, for those missing from `env_settings`."""
        return {}

    def allocate(self, view: EnvView) -> None:
        """Allocate state in the view's memory; by default none."""

    def begin(self, view: EnvView, index: int, rng: np.random.Generator) -> None:
        """Start an episode in one world."""

    def update(self, view: EnvView, indices: np.ndarray) -> None:
        """Update the state after a step of some of the worlds."""

    def progress(self, view: EnvView) -> Float[np.ndarray, " n"]:
        """Progress of the task, 0 to 1."""
        raise NotImplementedError

    def is_done(self, view: EnvView) -> Bool[np.ndarray, " n"]:
        """Return whether the task is completed; by default at a progress of 1."""
        return self.progress(view) >= 1.0

    def measures(self, view: EnvView) -> dict[str, np.ndarray]:
        """Return metrics in new arrays, for `info`; by default none."""
        return {}


@dataclass(frozen=True)
class Reward:
    """Weighted term of the reward.

    State is shared by all rewards of one kind.

    Attributes:
        weight: Factor of the term.
    """

    weight: Annotated[float, Range()] = 1.0

    kind: ClassVar[str]

    def __post_init__(self) -> None:
        check_fields(self)

    def allocate(self, view: EnvView) -> None:
        """Allocate state in the view's memory; by default none."""

    def begin(self, view: EnvView, index: int) -> None:
        """Start an episode in one world."""

    def update(self, view: EnvView, active: Bool[np.ndarray, " n"]) -> None:
        """Update the state after a step of the active worlds."""

    def term(self, view: EnvView) -> Float[np.ndarray, " n"]:
        """Value of each world for the last step, before weighting."""
        raise NotImplementedError

    def value(self, view: EnvView) -> Float[np.ndarray, " n"]:
        """Reward of each world for the last step."""
        return self.weight * self.term(view)


@dataclass(frozen=True)
class Observation:
    """One key of an agent's observation."""

    kind: ClassVar[str]

    @property
    def needs_textures(self) -> bool:
        """Whether it renders the appearance of the wall; False by default."""
        return False

    @property
    def name(self) -> str:
        """Key of the observation; by default its kind."""
        return self.kind

    def space(self, view: EnvView) -> Any:
        """Observation space of one world, a `gymnasium.spaces.Box`."""
        raise NotImplementedError

    def names(self, view: EnvView) -> tuple[str, ...]:
        """Name of each value, with its unit in brackets; by default with its index.

        Maps and images name their channels.
        """
        shape = self.space(view).shape
        return tuple(f"{self.name}_{k}" for k in range(shape[0]))

    def allocate(self, view: EnvView) -> None:
        """Allocate state in the view's memory; by default none."""

    def begin(self, view: EnvView, index: int, rng: np.random.Generator) -> None:
        """Start an episode in one world."""

    def observe(self, view: EnvView) -> np.ndarray:
        """Return the current observation of all worlds, in a new array."""
        raise NotImplementedError


@dataclass(frozen=True)
class Actuation:
    """Mapping from actions to the capsule's motion."""

    kind: ClassVar[str]

    def space(self) -> Any:
        """Action space of one world, a `gymnasium.spaces.Space`."""
        raise NotImplementedError

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each value of an action; by default with its index.

        Its value at an action of 1 is in brackets, with the unit.
        """
        return tuple(f"action_{k}" for k in range(int(np.prod(self.space().shape))))

    def allocate(self, view: EnvView) -> None:
        """Allocate state in the view's memory; by default none."""

    def begin(self, view: EnvView, index: int, start: State) -> tuple[Source, ...]:
        """Start an episode in one world whose capsule is at `start`.

        Returns:
            External magnets at their initial poses; by default none.
        """
        return ()

    def controls(
        self, view: EnvView, actions: np.ndarray, indices: np.ndarray
    ) -> Sequence[Control]:
        """Return the commands of the given worlds for the next control period.

        Args:
            view: The worlds.
            actions: A row for each of all worlds.
            indices: Indices of the worlds that move.
        """
        raise NotImplementedError

    def measures(self, view: EnvView) -> dict[str, np.ndarray]:
        """Return metrics in new arrays, for `info`; by default none."""
        return {}


TASKS: Registry[Task] = Registry(
    "task",
    {
        "coverage": ("vrcaps.env.tasks:CoverageTask", "see the whole wall"),
        "navigate": ("vrcaps.env.tasks:NavigateTask", "reach a position along the gut"),
        "inspect": ("vrcaps.env.tasks:InspectTask", "look at each lesion"),
    },
)
"""Tasks by name."""

REWARDS: Registry[Reward] = Registry(
    "reward",
    {
        "area-gain": ("vrcaps.env.rewards:AreaGain", "wall seen for the first time"),
        "log-gain": ("vrcaps.env.rewards:LogGain", "logarithm of the unseen area"),
        "paper": ("vrcaps.env.rewards:PaperGain", "reward of the VR-Caps paper"),
        "paper-thresholded": ("vrcaps.env.rewards:ThresholdedGain", "reward of VR-Caps' code"),
        "time": ("vrcaps.env.rewards:TimePenalty", "duration"),
        "force": ("vrcaps.env.rewards:ForcePenalty", "contact force"),
        "progress": ("vrcaps.env.rewards:ProgressGain", "progress of the task"),
        "total-variation": ("vrcaps.env.rewards:TotalVariation", "length of the frontier"),
        "success": ("vrcaps.env.rewards:Success", "completion of the task"),
    },
)
"""Rewards by name."""

OBSERVATIONS: Registry[Observation] = Registry(
    "observation",
    {
        "state": ("vrcaps.env.observations:StateObservation", "pose, velocity, contact"),
        "landmarks": (
            "vrcaps.env.landmarks:LandmarksObservation",
            "navigation features",
        ),
        "exploration": (
            "vrcaps.env.exploration:ExplorationObservation",
            "unknown space in the capsule's own map",
        ),
        "map": ("vrcaps.env.observations:MapObservation", "map of the seen wall"),
        "image": ("vrcaps.env.observations:ImageObservation", "image of a camera"),
    },
)
"""Observations by name."""

ACTUATIONS: Registry[Actuation] = Registry(
    "actuation",
    {
        "wrench": ("vrcaps.env.actuation:Wrench", "force and torque on the capsule"),
        "magnet": ("vrcaps.env.actuation:MagnetActuation", "velocity of an external magnet"),
        "arm": ("vrcaps.env.actuation:ArmActuation", "joint velocities of a robot with a magnet"),
        "coils": ("vrcaps.env.coil_actuation:CoilActuation", "currents of electromagnets"),
    },
)
"""Actuations by name."""

for _base, _members in ((Task, TASKS), (Reward, REWARDS)):
    register_family(_base, _members)
for _base, _members in ((Observation, OBSERVATIONS), (Actuation, ACTUATIONS)):
    register_family(_base, _members)
