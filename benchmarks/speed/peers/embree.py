"""Embree's bare primary rays, through embreex as trimesh and its users call it."""

from __future__ import annotations

import numpy as np

from benchmarks.speed.peers import load_package
from vrcaps.camera.camera import camera_rays
from vrcaps.cli.benchmarks.report import Subject
from vrcaps.cli.benchmarks.stage import Stage
from vrcaps.core.geometry import rotate_vectors

PRIMARY_RAYS = "Embree, primary rays only"


def subjects(stage: Stage) -> list[Subject]:
    """Nearest hit of every pixel's ray: distance, face and weights, without shading.

    Raises:
        PeerMissingError: If embreex is not installed.
    """
    core = load_package("embreex.rtcore_scene")
    construction = load_package("embreex.mesh_construction")
    scene = core.EmbreeScene()
    construction.TriangleMesh(
        scene,
        stage.model.vertices_world.astype(np.float32),
        np.asarray(stage.model.organ.faces, np.int32),
    )
    rays = camera_rays(stage.camera).reshape(-1, 3)
    rays = rays[np.isfinite(rays).all(axis=1)]
    queries = []
    for T in stage.Ts_world_camera():
        origins = np.tile(T[:3, 3], (len(rays), 1)).astype(np.float32)
        queries.append((origins, rotate_vectors(T, rays).astype(np.float32)))

    def frame(view: int) -> object:
        return scene.run(*queries[view], output=1)

    note = "same rays, prepared beforehand; one thread: embreex has no other way"
    return [Subject(PRIMARY_RAYS, frame, note)]
