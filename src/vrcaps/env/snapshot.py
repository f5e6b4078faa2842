"""Snapshot of an environment: its full state, in memory and in a file."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.core.errors import reading
from vrcaps.core.files import read_arrays, write_arrays
from vrcaps.world.snapshot import Snapshot, snapshot_arrays, snapshot_from_arrays

if TYPE_CHECKING:
    from jaxtyping import UInt8


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
