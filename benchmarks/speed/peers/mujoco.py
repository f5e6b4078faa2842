"""MuJoCo's own renderer, in software: rgb, depth and segmentation, a pass for each."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from benchmarks.speed.peers import PeerMissingError, load_package, welded_mesh
from vrcaps.cli.benchmarks.report import Subject
from vrcaps.cli.benchmarks.stage import Stage
from vrcaps.core.geometry import quaternion_from_matrix

ALL = "MuJoCo, rgb + depth + segmentation"

_FIELD_DEG = 100.0


def subjects(stage: Stage) -> list[Subject]:
    """All three images of a view, each read back.

    Raises:
        PeerMissingError: If MuJoCo is not installed or cannot make an OpenGL context.
    """
    os.environ.setdefault("MUJOCO_GL", "egl")
    mujoco = load_package("mujoco")
    model = _model(mujoco, stage)
    try:
        renderer = mujoco.Renderer(model, stage.camera.height, stage.camera.width)
    except (RuntimeError, ImportError, AttributeError, OSError) as error:
        raise PeerMissingError(
            f"MuJoCo cannot make an OpenGL context with MUJOCO_GL={os.environ['MUJOCO_GL']} "
            f"({error}); install libegl1 or libosmesa6"
        ) from error
    note = f"MUJOCO_GL={os.environ['MUJOCO_GL']}, perspective of {_FIELD_DEG:.0f}°, no shadows"
    return [Subject(ALL, _frame(mujoco, model, renderer, stage), note)]


def _frame(mujoco: Any, model: Any, renderer: Any, stage: Stage) -> Any:
    data = mujoco.MjData(model)
    # MuJoCo's cameras look along -z with y up.
    flip = np.diag([1.0, -1.0, -1.0])
    poses = stage.Ts_world_camera()

    def frame(view: int) -> object:
        data.mocap_pos[0] = poses[view][:3, 3]
        data.mocap_quat[0] = quaternion_from_matrix(poses[view][:3, :3] @ flip)
        mujoco.mj_forward(model, data)
        renderer.update_scene(data, "eye")
        images = [renderer.render().copy()]
        renderer.enable_depth_rendering()
        images.append(renderer.render().copy())
        renderer.disable_depth_rendering()
        renderer.enable_segmentation_rendering()
        images.append(renderer.render().copy())
        renderer.disable_segmentation_rendering()
        return images

    return frame


def _model(mujoco: Any, stage: Stage) -> Any:
    mesh, look = welded_mesh(stage), stage.model.organ.appearance
    assert look is not None
    spec = mujoco.MjSpec()
    spec.visual.global_.offwidth = stage.camera.width
    spec.visual.global_.offheight = stage.camera.height
    spec.visual.headlight.active = 0
    spec.stat.extent = 1.0
    spec.visual.map.znear, spec.visual.map.zfar = 1e-3, 2.0
    height, width, _ = look.albedo.shape
    spec.add_texture(
        name="mucosa",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        width=width,
        height=height,
        nchannel=3,
        data=look.albedo.ravel().tolist(),
    )
    material = spec.add_material(name="mucosa", specular=0.5, shininess=0.9)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "mucosa"
    spec.add_mesh(
        name="wall",
        uservert=mesh.vertices.ravel(),
        usernormal=mesh.normals.ravel(),
        usertexcoord=mesh.uv.ravel(),
        userface=mesh.faces.ravel().astype(np.int32),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
    )
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname="wall",
        material="mucosa",
        contype=0,
        conaffinity=0,
    )
    capsule = spec.worldbody.add_body(name="capsule", mocap=True)
    capsule.add_camera(name="eye", fovy=_FIELD_DEG)
    for led in stage.camera.leds:
        x, y, z = led.position_camera
        capsule.add_light(pos=[x, -y, -z], dir=[0, 0, -1], castshadow=False, exponent=1.0)
    return spec.compile()
