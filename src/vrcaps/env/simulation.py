"""Simulation of an environment: reset, stepping, snapshots and derived state of its worlds."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps import __version__
from vrcaps.core.errors import InputError, reading, require
from vrcaps.core.files import read_arrays, write_arrays
from vrcaps.env.cameras import CameraImages
from vrcaps.env.parts import EnvView
from vrcaps.env.patients import Patients
from vrcaps.env.randomization import FACTORS, varied_device, varied_tissue
from vrcaps.env.settings import EnvSettings
from vrcaps.env.worlds import Coverage, EnvWorlds, Memory
from vrcaps.world.control import Control
from vrcaps.world.model import State
from vrcaps.world.snapshot import Snapshot, snapshot_arrays, snapshot_from_arrays
from vrcaps.world.world import World

if TYPE_CHECKING:
    from jaxtyping import Bool, UInt8

_TEXTS = ("failure", "generator")


@dataclass(frozen=True)
class WorldSnapshot:
    """Full state of one world of an environment.

    Attributes:
        world: Capsule and wall.
        memory: State of task, actuation and observations.
        flags: Levels at which each point of the wall was seen.
        failure: Reason why it could not be stepped; empty without failure.
        generator: State of its random generator, as JSON.
        is_over: Whether its episode is over.
    """

    world: Snapshot
    memory: dict[str, np.ndarray]
    flags: UInt8[np.ndarray, " k"]
    failure: str
    generator: str
    is_over: bool


@dataclass(frozen=True)
class EnvSnapshot:
    """Full state of an environment, of one or more worlds.

    An environment of the same settings that restores it continues with the same bytes.

    Example:
        >>> snapshot = env.snapshot()
        >>> write_env_snapshot(Path("start.npz"), snapshot)
        >>> observation = env.restore(read_env_snapshot(Path("start.npz")))

    Attributes:
        settings: Fingerprint of the environment's settings.
        version: Version of the package.
        worlds: State of each world.
    """

    settings: str
    version: str
    worlds: tuple[WorldSnapshot, ...]


def write_env_snapshot(path: Path, snapshot: EnvSnapshot) -> None:
    """Write a snapshot as a NumPy archive (.npz) atomically."""
    arrays = {"settings": np.array(snapshot.settings), "version": np.array(snapshot.version)}
    for k, saved in enumerate(snapshot.worlds):
        parts = {f"world/{name}": array for name, array in snapshot_arrays(saved.world).items()}
        parts |= {f"memory/{name}": array for name, array in saved.memory.items()}
        parts |= {name: np.array(getattr(saved, name)) for name in (*_TEXTS, "flags", "is_over")}
        arrays |= {f"{k}/{name}": array for name, array in parts.items()}
    write_arrays(path, arrays)


def read_env_snapshot(path: Path) -> EnvSnapshot:
    """Read a snapshot that `write_env_snapshot` wrote.

    Raises:
        InputError: If the file is not a snapshot of an environment.
    """
    with reading(f"the snapshot of an environment {path}"):
        arrays = read_arrays(path)
        worlds = {name.partition("/")[0] for name in arrays if "/" in name}
        return EnvSnapshot(
            str(arrays["settings"]),
            str(arrays["version"]),
            tuple(_world_of(arrays, f"{k}/") for k in range(len(worlds))),
        )


def _world_of(arrays: dict[str, np.ndarray], start: str) -> WorldSnapshot:
    def part(of: str) -> dict[str, np.ndarray]:
        first = start + of
        return {name.removeprefix(first): a for name, a in arrays.items() if name.startswith(first)}

    return WorldSnapshot(
        snapshot_from_arrays(part("world/")),
        part("memory/"),
        arrays[start + "flags"],
        *(str(arrays[start + name]) for name in _TEXTS),
        is_over=bool(arrays[start + "is_over"]),
    )


def fingerprint(settings: Any) -> str:
    """Fingerprint of settings, also with organs in memory; equal settings have the same."""
    digest = hashlib.sha256()

    def add(value: Any) -> None:
        if isinstance(value, np.ndarray):
            digest.update(f"{value.dtype}{value.shape}".encode())
            digest.update(np.ascontiguousarray(value).tobytes())
        elif is_dataclass(value):
            digest.update(type(value).__name__.encode())
            for field in fields(value):
                digest.update(field.name.encode())
                add(getattr(value, field.name))
        elif isinstance(value, tuple | list):
            digest.update(f"{len(value)}".encode())
            for item in value:
                add(item)
        else:
            digest.update(repr(value).encode())

    add(settings)
    return digest.hexdigest()


class Simulation:
    """Parallel worlds with their coverage, images, task, actuation and observations.

    Attributes:
        settings: Settings of the environment.
        num_worlds: Number of worlds.
        memory: State that changes from step to step; part of a snapshot.
        worlds: The worlds and their state.
        coverage: Coverage of the wall.
        cameras: Images.
        view: View of all these for the parts of an environment.
        failure: Reason why a world could not be stepped; empty without failure.
    """

    def __init__(
        self,
        settings: EnvSettings,
        num_worlds: int,
        *,
        with_textures: bool = False,
        patients: Patients | None = None,
    ) -> None:
        """Allocate buffers; worlds are created by `reset`.

        Args:
            settings: Settings of the environment.
            num_worlds: Number of worlds.
            with_textures: Whether walls have textures even if no observation needs them.
            patients: Patients of a simulation with the same arguments, to share; None creates them.

        Raises:
            UnknownNameError: If the capsule has no camera that an observation names.
        """
        self.settings, self.num_worlds = settings, num_worlds
        self.memory = memory = Memory(num_worlds)
        with_textures |= any(observation.needs_textures for observation in settings.observations)
        patients = patients or settings.patients(with_textures=with_textures)
        self.worlds = EnvWorlds(memory, patients, settings.posture)
        self.coverage = Coverage(self.worlds, settings.grid, settings.criteria)
        self._start = memory.allocate("start", (4, 4))
        self._factors = memory.allocate("randomization/factors", (len(FACTORS),), fill=1.0)
        self.failure = [""] * num_worlds
        self.cameras = CameraImages(self.worlds, settings.randomization, settings.control_period)
        self.view = self._make_view()
        for part in (settings.actuation, settings.task, *settings.observations):
            part.allocate(self.view)

    def _make_view(self) -> EnvView:
        settings, worlds = self.settings, self.worlds
        return EnvView(
            task=settings.task,
            actuation=settings.actuation,
            control_period=settings.control_period,
            episode_time=settings.episode_time,
            dynamics=settings.dynamics,
            relaxation_time=settings.relaxation_time,
            criteria=settings.criteria,
            grid=settings.grid,
            memory=self.memory,
            coverage=self.coverage,
            cameras=self.cameras,
            _worlds=worlds,
            time=_read_only(worlds.time),
            arc_length=_read_only(worlds.arc_length),
            T_world_capsule=_read_only(worlds.T_world_capsule),
            velocity_world=_read_only(worlds.velocity_world),
            contact_force_world=_read_only(worlds.contact_force_world),
            normal_force_total=_read_only(worlds.normal_force_total),
        )

    def reset(self, index: int, rng: np.random.Generator, patient: int | None = None) -> None:
        """Start an episode in one world.

        Args:
            index: Index of the world.
            rng: Random generator.
            patient: Index of the patient; None draws one.

        Raises:
            InputError: If the organ cannot be created, or the capsule does not fit in it.
        """
        settings = self.settings
        drawn = rng.integers(len(self.worlds.patients))
        model = self.worlds.enter(index, int(drawn if patient is None else patient))
        start, self.worlds.arc_length[index] = settings.start.draw(model, rng)
        self._start[index] = start.T_world_capsule
        self._factors[index], self.worlds.effects_seed[index] = settings.randomization.draw(rng)
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
        self.worlds.enter(index, 0)
        self._start[index] = world.T_world_capsule
        self.worlds.arc_length[index] = arc_length
        self.settings.actuation.begin(self.view, index, world.state)
        self.worlds.put(index, world)
        self._begin(index, rng)

    def _begin(self, index: int, rng: np.random.Generator) -> None:
        """Reset coverage, task and observations of one world."""
        self.coverage.begin(index)
        self.worlds.time[index], self.failure[index] = 0.0, ""
        self.cameras.begin(index)
        self._update(np.array([index]))
        self.settings.task.begin(self.view, index, rng)
        for observation in self.settings.observations:
            observation.begin(self.view, index, rng)

    def _make_world(self, index: int, seed: int) -> World:
        """Create a world at its start pose, with the sources of the actuation."""
        settings, start = self.settings, State(0.0, self._start[index].copy())
        sources = settings.actuation.begin(self.view, index, start)
        model, factors = self.worlds.patient(index).model, self._factors[index]
        nominal = self.worlds.device
        self.worlds.devices[index] = device = varied_device(nominal, factors)
        world = World(
            model if device is nominal else model.with_device(device),
            varied_tissue(settings.tissue, factors),
            start,
            dynamics=settings.dynamics,
            substep=settings.substep,
            seed=seed,
            sources=sources,
        )
        self.worlds.put(index, world)
        return world

    def snapshot(self, index: int, generator: str = "", is_over: bool = False) -> WorldSnapshot:
        """Return the full state of one world.

        Args:
            index: Index of the world.
            generator: State of its random generator, as JSON.
            is_over: Whether its episode is over.
        """
        return WorldSnapshot(
            self.worlds.batch.worlds[index].snapshot(),
            self.memory.row(index),
            self.coverage.flags[index].copy(),
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
        self.coverage.flags[index], self.failure[index] = saved.flags.copy(), saved.failure
        self.cameras.expire(np.array([index]))
        # Repeated, since the creation of the world has changed some of it.
        self.memory.set_row(index, saved.memory)

    def step(self, actions: np.ndarray, active: Bool[np.ndarray, " n"]) -> None:
        """Advance the active worlds by one control period.

        A world that cannot be stepped keeps its state and reports the reason in `failure`.
        """
        indices, period = np.flatnonzero(active), self.settings.control_period
        controls = self.settings.actuation.controls(self.view, actions, indices)
        failures = self.worlds.batch.try_step(controls, period, indices)
        for index, failure in failures.items():
            self.failure[index] = failure
        self.arrive(indices, period)

    def arrive(self, indices: np.ndarray, duration: float) -> None:
        """Update the state after the given worlds have advanced by a time [s]."""
        self.worlds.time[indices] += duration
        self._update(indices)
        self.settings.task.update(self.view, indices)

    def _update(self, indices: np.ndarray) -> None:
        """Update state and coverage from some of the worlds; their images are outdated."""
        self.worlds.read(indices)
        self.cameras.expire(indices)
        self.coverage.update(indices)


def take_snapshot(
    simulation: Simulation,
    indices: Sequence[int],
    generators: Sequence[np.random.Generator],
    is_over: Bool[np.ndarray, " n"],
) -> EnvSnapshot:
    """Take a snapshot of some worlds of an environment after its first reset.

    Args:
        simulation: The worlds.
        indices: Indices of the worlds in the snapshot.
        generators: Random generators of all worlds.
        is_over: Whether each world's episode is over.
    """

    def taken(k: int) -> WorldSnapshot:
        generator = json.dumps(generators[k].bit_generator.state)
        return simulation.snapshot(k, generator, bool(is_over[k]))

    worlds = tuple(taken(k) for k in indices)
    return EnvSnapshot(fingerprint(simulation.settings), __version__, worlds)


def restore_snapshot(
    simulation: Simulation,
    snapshot: EnvSnapshot,
    indices: Sequence[int],
    generators: Sequence[np.random.Generator],
) -> None:
    """Restore worlds from a snapshot.

    Args:
        simulation: All worlds.
        snapshot: Snapshot of as many worlds as there are indices.
        indices: Indices of the worlds to restore.
        generators: Random generators of all worlds; their state is restored as well.

    Raises:
        InputError: If the snapshot is of other settings, another version or another number of
            worlds, or damaged.
    """
    if snapshot.settings != fingerprint(simulation.settings):
        raise InputError(
            "The snapshot is of an environment with other settings. Give one of an environment "
            "with the same settings."
        )
    version = __version__
    require(snapshot.version == version, "The snapshot's version", snapshot.version, version)
    given = len(snapshot.worlds)
    require(given == len(indices), "The snapshot's number of worlds", given, f"{len(indices)}")
    for k, saved in zip(indices, snapshot.worlds, strict=True):
        with reading(f"the random generator of world {k} of the snapshot"):
            generators[k].bit_generator.state = json.loads(saved.generator)
        simulation.restore(k, saved)


def _read_only(array: np.ndarray) -> np.ndarray:
    """Read-only view of an array."""
    view = array.view()
    view.flags.writeable = False
    return view
