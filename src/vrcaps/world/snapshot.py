"""Snapshot of a world: its complete variable state, exactly, in memory or in a file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.core.errors import InputError, require
from vrcaps.core.files import read_arrays, write_arrays

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.tissue.fem.wall import FemWall


@dataclass(frozen=True)
class Snapshot:
    """State from which a `World` continues with identical bytes.

    Positions are in the patient frame, relative to the wall's center.

    Attributes:
        seed: Seed of the world, see `World`.
        time: Time since the start of the run [s].
        began: Time of the world's first state [s], from which its muscle wakes.
        T_world_patient: Posture of the patient.
        capsule: Position [m], quaternion wxyz, velocity [m/s], angular velocity [rad/s].
        lumen_scale: Radius of the lumen at the samples, relative to that at rest.
        active_wall: Wall vertices under muscle and gas alone [m].
        wall_displacement: Displacement [m] and velocity [m/s] of each vertex.
        layer: For each free node of an elastic layer: displacement [m], velocity [m/s], force [N],
            offset of the wall in contact with the capsule from it [m], and momentum still to be
            transferred to it [N·s]; empty without a layer.
        contact_faces: For each triangle that loads the layer: index, normal force and friction [N].
        contents: Lumen contents; empty without any.
        contact: Effect of the wall in the last step: force, torque, and the other values of
            `Contact` in order.
        controller: State of the magnet controller, see its `to_array`; empty without one.
        sources: Position [m], quaternion wxyz and strength of each source in the world.
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
    """Write a snapshot as a NumPy archive (.npz), atomically."""
    write_arrays(path, snapshot_arrays(snapshot))


def read_snapshot(path: Path) -> Snapshot:
    """Read a snapshot written by `write_snapshot`.

    Raises:
        InputError: If the file is not a snapshot.
    """
    try:
        return snapshot_from_arrays(read_arrays(path))
    except (OSError, ValueError) as error:
        raise InputError(f"{path} is not a snapshot of a world: {error}.") from error


def snapshot_arrays(snapshot: Snapshot) -> dict[str, np.ndarray]:
    """Convert a snapshot to arrays by name."""
    return {f.name: np.asarray(getattr(snapshot, f.name)) for f in fields(Snapshot)}


def snapshot_from_arrays(arrays: Mapping[str, np.ndarray]) -> Snapshot:
    """Convert arrays of `snapshot_arrays` to a snapshot.

    Raises:
        ValueError: If an array is missing, or has a wrong type or number of values.
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
    """Check that a snapshot fits the world of another snapshot.

    Raises:
        InputError: If it has another seed or wall, or is not finite.
    """
    require(snapshot.seed == own.seed, "seed", snapshot.seed, f"this world's, {own.seed}")
    if snapshot.active_wall.shape != own.active_wall.shape:
        raise InputError(
            f"The snapshot has a wall of {len(snapshot.active_wall)} vertices, the model has "
            f"{len(own.active_wall)}. Give a snapshot of the same organ."
        )
    for name, mine in vars(own).items():
        if name in ("layer", "contact_faces", "controller"):
            continue  # checked by the layer or controller that uses it
        given = getattr(snapshot, name)
        if np.shape(given) != np.shape(mine):
            raise InputError(
                f"The snapshot's {name} has the shape {np.shape(given)}. "
                f"Allowed: {np.shape(mine)}, as in this world."
            )
        if not np.isfinite(given).all():
            raise InputError(f"The snapshot's {name} is not finite. Allowed: finite numbers.")


def coupling_state_of(
    layer: FemWall, snapshot: Snapshot
) -> tuple[Float[np.ndarray, "nodes 6"], tuple[Float[np.ndarray, "nodes 9"], np.ndarray]]:
    """Motion of the layer in a snapshot, and the persistent state of its coupling to the capsule.

    Raises:
        InputError: If the snapshot is of another layer or not finite.
    """
    if snapshot.layer.shape != (layer.num_free, 15):
        raise InputError(
            f"The snapshot has a layer of {len(snapshot.layer)} nodes, the world's has "
            f"{layer.num_free}. Give a snapshot of a world with the same deformation."
        )
    if not (np.isfinite(snapshot.layer).all() and np.isfinite(snapshot.contact_faces).all()):
        raise InputError("The snapshot is not finite. Allowed: finite numbers.")
    motion, forces = np.hsplit(snapshot.layer, [6])
    return motion, (
        np.ascontiguousarray(forces),
        np.ascontiguousarray(snapshot.contact_faces, float),
    )
