"""Settings of an environment, as one typed tree."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Annotated, Any, Literal, get_type_hints

from vrcaps.capsule.device import Device
from vrcaps.capsule.device_file import device_of
from vrcaps.config.convert import from_plain, to_plain
from vrcaps.core.errors import InputError, UnknownNameError, require
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.registry import Registry
from vrcaps.env.actuation import Wrench
from vrcaps.env.observations import StateObservation
from vrcaps.env.parts import (
    ACTUATIONS,
    OBSERVATIONS,
    REWARDS,
    TASKS,
    Actuation,
    Observation,
    Reward,
    Task,
)
from vrcaps.env.patients import Organ, Patients, organs_of
from vrcaps.env.randomization import Randomization, Start
from vrcaps.env.tasks import CoverageTask
from vrcaps.env.transmission import Transmission
from vrcaps.lesion import Lesion
from vrcaps.lesion.library import parse_lesion
from vrcaps.metrics.coverage import CoverageCriteria
from vrcaps.organ.surface import OrganSurface
from vrcaps.scenario.scenario import OrganFile, OrganGenerated
from vrcaps.tissue.tissue import Tissue
from vrcaps.world.mechanics import RELAXATION_TIME
from vrcaps.world.model import posture_transform

_MAX_TIME = 7 * 86400.0
"""Maximum duration of an episode [s], a week, because a policy file may state any duration."""
_MAX_CELLS = 1024
_SETTINGS: dict[str, type] = {
    "tissue": Tissue,
    "randomization": Randomization,
    "transmission": Transmission,
    "start": Start,
    "criteria": CoverageCriteria,
}
"""Types of the settings that are dataclasses of one kind."""


@dataclass(frozen=True)
class EnvSettings:
    """Contents, actions, observations and rewards of an environment.

    Example:
        >>> settings = EnvSettings(organs=("stomach",), actuation=Wrench(torque=0.0))
        >>> env = vrcaps.env.CapsuleEnv(settings)

    Attributes:
        task: Task of the agent.
        actuation: Mapping from actions to the capsule's motion.
        observations: Observations of the agent; each is a key of a dictionary.
        rewards: Terms of the reward; empty for the task's defaults.
        organs: Patients, one of which is drawn at each reset; a string names an organ, its seeds or
            a file, such as ``stomach``, ``stomach:0-15`` or ``mine.ply:mm``.
        capsule: Name in the catalog, path of a device file, or a device in memory.
        posture: Posture of the patient.
        lesions: Lesions to insert into each organ.
        dynamics: `quasi-static` neglects inertia and is fast; `physics` is the full simulation.
        substep: Maximum substep of `physics` [s].
        tissue: Properties of the wall. If its drag has no relaxation time, that of quasi-static
            motion is used, so that the capsule's momentum decays equally in both dynamics.
        randomization: Domain randomization of tissue, capsule and camera.
        transmission: Delay, dropout and quantization of actions and images.
        start: Distribution of the initial pose.
        control_period: Time between actions [s].
        episode_time: Time after which an episode is truncated [s].
        stuck_time: Time without progress after which an episode is truncated [s].
        max_speed: Speed above which an episode is truncated, without reward [m/s]: that of a
            throw, faster than a capsule that falls across a stomach. VR-Caps' code has 0.35.
        criteria: Criteria for a part of the wall to count as seen.
        num_points: Number of sample points of the wall, weighted by area.
        grid: Number of cells of the map of the wall, along the gut and around it.
    """

    task: Task = field(default_factory=CoverageTask)
    actuation: Actuation = field(default_factory=Wrench)
    observations: tuple[Observation, ...] = (StateObservation(),)
    rewards: tuple[Reward, ...] = ()
    organs: tuple[Organ, ...] = (OrganGenerated("stomach"),)
    capsule: str | Device = "magnetic"
    posture: str = "supine"
    lesions: tuple[Lesion, ...] = ()
    dynamics: Literal["quasi-static", "physics"] = "quasi-static"
    substep: Annotated[float, Range(above=0.0, max=1e-3, unit="s")] = 2e-4
    tissue: Tissue = field(default_factory=Tissue)
    randomization: Randomization = field(default_factory=Randomization)
    transmission: Transmission = field(default_factory=Transmission)
    start: Start = field(default_factory=Start)
    control_period: Annotated[float, Range(above=0.0, max=1.0, unit="s")] = 5.0 / 30.0
    episode_time: Annotated[float, Range(above=0.0, max=_MAX_TIME, unit="s")] = 60.0
    stuck_time: Annotated[float, Range(above=0.0, max=_MAX_TIME, unit="s")] = 20.0
    max_speed: Annotated[float, Range(above=0.0, max=1e3, unit="m/s")] = 1.5
    criteria: CoverageCriteria = field(default_factory=CoverageCriteria)
    num_points: Annotated[int, Range(min=64, max=2**20)] = 4096
    grid: tuple[int, int] = (32, 16)

    def __post_init__(self) -> None:
        check_fields(self)
        posture_transform(self.posture)
        if not self.organs:
            raise InputError("organs is empty. Allowed: at least one.")
        object.__setattr__(self, "organs", tuple(organs_of(self.organs)))
        if self.tissue.drag.relaxation_time is None:
            drag = replace(self.tissue.drag, relaxation_time=RELAXATION_TIME)
            object.__setattr__(self, "tissue", replace(self.tissue, drag=drag))
        names = [observation.name for observation in self.observations]
        if not names or len(set(names)) < len(names):
            raise InputError(
                f"observations are {', '.join(names) or 'empty'}. Allowed: at least one, each once."
            )
        is_grid = min(self.grid) >= 1 and max(self.grid) <= _MAX_CELLS
        require(is_grid, "grid", self.grid, f"1 to {_MAX_CELLS} cells along each axis")

    def __deepcopy__(self, memo: object) -> EnvSettings:
        """Return itself, since it is immutable and organs in memory are large."""
        return self

    def patients(self, *, with_textures: bool = False) -> Patients:
        """Patients, which are created on first use.

        Args:
            with_textures: Whether their walls will be rendered.
        """
        return Patients(
            self.organs,
            device_of(self.capsule),
            posture=self.posture,
            lesions=self.lesions,
            num_points=self.num_points,
            grid=self.grid,
            with_textures=with_textures,
        )

    @property
    def relaxation_time(self) -> float:
        """Time constant with which the lumen contents damp a capsule's momentum [s]."""
        return self.tissue.drag.relaxation_time or RELAXATION_TIME


def env_settings(**keywords: Any) -> EnvSettings:
    """Create settings from keyword arguments; parts may be given by name or as a table.

    Defaults depend on the task.

    Example:
        >>> env_settings(task="coverage", actuation="magnet", observations=("state", "map"))

    Raises:
        InputError: If a keyword is not a field, or a value is not allowed.
        UnknownNameError: If a part is unknown.
    """
    known = [f.name for f in fields(EnvSettings)]
    for name in keywords:
        if name not in known:
            raise UnknownNameError("setting", name, known)
    if "task" in keywords:
        keywords["task"] = _part(TASKS, keywords["task"])
        keywords = keywords["task"].defaults | keywords
    if "actuation" in keywords:
        keywords["actuation"] = _part(ACTUATIONS, keywords["actuation"])
    for name, registry in (("observations", OBSERVATIONS), ("rewards", REWARDS)):
        if name in keywords:
            given = keywords[name]
            parts = (given,) if isinstance(given, str | Mapping) else given
            keywords[name] = tuple(_part(registry, part) for part in parts)
    if "lesions" in keywords:
        given = keywords["lesions"]
        given = (given,) if isinstance(given, str) else given
        keywords["lesions"] = tuple(parse_lesion(x) if isinstance(x, str) else x for x in given)
    tables = [name for name in _SETTINGS if isinstance(keywords.get(name), Mapping)]
    keywords |= {name: from_plain(_SETTINGS[name], keywords[name], at=name) for name in tables}
    if isinstance(keywords.get("organs"), str):
        keywords["organs"] = (keywords["organs"],)
    values: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value for name, value in keywords.items()
    }
    return EnvSettings(**values)


def plain_environment(env: EnvSettings) -> dict[str, Any]:
    """Settings of an environment as plain values; an organ in memory as its name and checksum."""
    hints = get_type_hints(EnvSettings)
    plain = {
        f.name: to_plain(getattr(env, f.name), hints[f.name])
        for f in fields(env)
        if f.name != "organs"
    }
    plain["organs"] = [
        {"name": organ.name, "sha256": hashlib.sha256(organ.vertices.tobytes()).hexdigest()}
        if isinstance(organ, OrganSurface)
        else to_plain(organ, OrganGenerated | OrganFile)
        for organ in env.organs
    ]
    return plain


def _part(registry: Registry[Any], given: Any) -> Any:
    """Create a part from its name or a table with its kind, or return it unchanged."""
    if isinstance(given, Mapping):
        base = {"task": Task, "actuation": Actuation, "observation": Observation}
        return from_plain(base.get(registry.noun, Reward), given, at=registry.noun)
    return registry[given]() if isinstance(given, str) else given
