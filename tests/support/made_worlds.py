"""Several worlds in one organ, and a snapshot as bytes."""

from __future__ import annotations

import numpy as np

from vrcaps.tissue.tissue import Tissue
from vrcaps.world.mechanics import DynamicsKind
from vrcaps.world.model import Model
from vrcaps.world.snapshot import Snapshot
from vrcaps.world.world import World


def worlds_in(model: Model, dynamics: DynamicsKind = "physics") -> list[World]:
    """Four at places along the gut."""
    places = model.organ.centerline.arc_length[[60, 100, 150, 200]]
    return [World(model, Tissue(), model.place(s), dynamics=dynamics) for s in places]


def as_bytes(snapshot: Snapshot) -> bytes:
    """All its arrays in a row."""
    return b"".join(np.asarray(value).tobytes() for value in vars(snapshot).values())
