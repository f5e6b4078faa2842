"""Snapshot of a world: all that changes, exactly, in memory and in a file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.errors import InputError, require
from vrcaps.files import read_arrays, write_arrays

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclass(frozen=True)
class Snapshot:
    """What a `World` needs to go on to the same bytes.

    Positions are in the patient frame about the wall's center.

    Attributes:
        seed: Of the world, see `World`.
        time: Since the start of the run [s].
        began: Time of the world's first state [s]: its muscle wakes from there on.
        T_world_patient: How the patient lies.
        capsule: Position [m], quaternion wxyz, velocity [m/s], angular velocity [rad/s].
        lumen_scale: Lumen's radius at the samples, as a share of that at rest.
        active_wall: Wall vertices as muscle and gas alone would have them [m].
        wall_displacement: How far each vertex gives way [m] and at which velocity [m/s].
        layer: Of each free node of an elastic layer: displacement [m], velocity [m/s], force [N],
            how far the wall that the capsule felt is off it [m], and momentum it is still to be
            given [N·s]; empty where there is none.
        contact_faces: Of each triangle that loads the layer: number, normal force and friction [N].
        contents: What floats in the lumen; empty where nothing does.
        contact: What the wall did in the last step: force, torque, and the other numbers of
            `Contact` in their order.
        controller: State of the magnet controller, see its `to_array`; empty without one.
        sources: Place [m], quaternion wxyz and strength of each source in the world.
    """

    seed: int
    time: float
    began: float
    T_world_patient: Float[np.ndarray, "4 4"]
    capsule: Float[np.ndarray, " 13"]
    lumen_scale: Float[np.ndarray, " k"]
    active_wall: Float[np.ndarray, "n 3"]
    wall_displacement: Float[np.ndarray, "n 6"]
    layer: Float[np.ndarray, "nodes 15"]
    contact_faces: Float[np.ndarray, "k 5"]
    contents: Float[np.ndarray, " q"] = field(default_factory=lambda: np.zeros(0))
    contact: Float[np.ndarray, " 11"] = field(default_factory=lambda: np.zeros(11))
    controller: Float[np.ndarray, " r"] = field(default_factory=lambda: np.zeros(0))
    sources: Float[np.ndarray, "s 8"] = field(default_factory=lambda: np.zeros((0, 8)))


def write_snapshot(path: Path, snapshot: Snapshot) -> None:
    """Write a snapshot as a NumPy archive (.npz), whole or not at all."""
    write_arrays(path, snapshot_arrays(snapshot))


def read_snapshot(path: Path) -> Snapshot:
    """Read what `write_snapshot` wrote.

    Raises:
        InputError: If the file is not a snapshot.
    """
    try:
        return snapshot_from_arrays(read_arrays(path))
    except (OSError, ValueError) as error:
        raise InputError(f"{path} is no snapshot of a world: {error}.") from error


def snapshot_arrays(snapshot: Snapshot) -> dict[str, np.ndarray]:
    """A snapshot as arrays by name."""
    return {f.name: np.asarray(getattr(snapshot, f.name)) for f in fields(Snapshot)}


def snapshot_from_arrays(arrays: Mapping[str, np.ndarray]) -> Snapshot:
    """The snapshot that `snapshot_arrays` took apart.

    Raises:
        ValueError: If an array is missing, or has another type or more than one number.
    """
    missing = [f.name for f in fields(Snapshot) if f.name not in arrays]
    if missing:
        raise ValueError(f"it lacks {missing[0]}")
    own: dict[str, Any] = {f.name: arrays[f.name] for f in fields(Snapshot)}
    for name, value in own.items():
        if value.dtype.kind not in "biuf":
            raise ValueError(f"{name} does not hold numbers")
    for name in ("seed", "time", "began"):
        own[name] = own[name].item()
    return Snapshot(**own)


def check_snapshot(snapshot: Snapshot, own: Snapshot) -> None:
    """Check that a snapshot fits a world that has a snapshot of its own.

    Raises:
        InputError: If it is of another seed or wall, or not finite.
    """
    require(snapshot.seed == own.seed, "seed", snapshot.seed, f"this world's, {own.seed}")
    if snapshot.active_wall.shape != own.active_wall.shape:
        raise InputError(
            f"The snapshot has a wall of {len(snapshot.active_wall)} vertices, the model has "
            f"{len(own.active_wall)}. Give a snapshot of the same organ."
        )
    for name, mine in vars(own).items():
        if name in ("layer", "contact_faces", "controller"):
            continue  # what a layer or a controller needs is checked where it is taken apart
        given = getattr(snapshot, name)
        if np.shape(given) != np.shape(mine):
            raise InputError(
                f"The snapshot's {name} has the shape {np.shape(given)}. "
                f"Allowed: {np.shape(mine)}, as in this world."
            )
        if not np.isfinite(given).all():
            raise InputError(f"The snapshot's {name} is not finite. Allowed: finite numbers.")
