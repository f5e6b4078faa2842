"""Several worlds in one organ, and a snapshot as bytes."""

from __future__ import annotations

import numpy as np

from vrcaps.tissue.tissue import Tissue
from vrcaps.world.dynamics import DynamicsKind
from vrcaps.world.model import Model, State
from vrcaps.world.snapshot import Snapshot
from vrcaps.world.world import World


def worlds_in(model: Model, dynamics: DynamicsKind = "physics") -> list[World]:
    """Four at places along the gut."""
    line, worlds = model.organ.centerline, []
    for sample in (60, 100, 150, 200):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = line.frames[sample], line.points[sample]
        start = State(0.0, model.T_world_patient @ pose)
        worlds.append(World(model, Tissue(), start, dynamics=dynamics))
    return worlds


def as_bytes(snapshot: Snapshot) -> bytes:
    """All its arrays in a row."""
    return b"".join(np.asarray(value).tobytes() for value in vars(snapshot).values())
