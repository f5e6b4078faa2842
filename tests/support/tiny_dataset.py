"""A data set whose recordings take no time: a short tube, and one camera of a few pixels."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh

from tests.support.small_episode import CAMERA, DEVICE
from tests.support.write_ply import write_ply
from vrcaps.mesh.mesh import Mesh
from vrcaps.organ.organ_file import write_organ
from vrcaps.organ.read_organ import read_organ
from vrcaps.organ.surface import Appearance

PLAN = """
frames = 2
capsule = "tiny.toml"
channels = ["rgb", "depth"]
seed = {{ integer = [0, 1000000] }}

[organ]
kind = "file"
path = "tube.glb"

[motion]
speed = {{ each = [0.005, 0.01] }}
drift = {{ uniform = [0.0, 0.3] }}

[dataset]
name = "tiny"
patients = {patients}
"""
PER_PATIENT = 2


def write_tiny_plan(folder: Path, units: int) -> Path:
    """A plan of some units, with the files that it names; it is read from its folder."""
    folder.mkdir(parents=True, exist_ok=True)
    tube = trimesh.creation.capsule(height=0.2, radius=0.02, count=[24, 32])
    write_ply(folder / "tube.ply", Mesh(np.asarray(tube.vertices), np.asarray(tube.faces)))
    organ = read_organ(folder / "tube.ply", unit="m")
    albedo = np.random.default_rng(0).integers(90, 200, (32, 32, 3), np.uint8)
    flat = np.full((32, 32), 128, np.uint8)
    appearance = Appearance(albedo, roughness=flat, height=np.zeros((32, 32), np.float32))
    write_organ(folder / "tube.glb", replace(organ, appearance=appearance))
    front = CAMERA.format(name="front", z=11, rotation="[[1, 0, 0], [0, 1, 0], [0, 0, 1]]")
    (folder / "tiny.toml").write_text(DEVICE + front)
    path = folder / "plan.toml"
    path.write_text(PLAN.format(patients=units // PER_PATIENT))
    return path
