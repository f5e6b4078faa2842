"""Elastic layer of a world: its creation and its part of a snapshot."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import InputError
from vrcaps.tissue.fem.deformation import FemDeformation
from vrcaps.tissue.tissue import Tissue
from vrcaps.world.snapshot import Snapshot

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.organ.surface import OrganSurface
    from vrcaps.tissue.fem.wall import FemWall


def make_fem_wall(organ: OrganSurface, tissue: Tissue) -> FemWall | None:
    """Create the elastic layer under an organ's surface, if the tissue has one."""
    if not isinstance(tissue.deformation, FemDeformation):
        return None
    from vrcaps.tissue.fem.wall import FemWall

    return FemWall(organ, tissue.deformation)


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
