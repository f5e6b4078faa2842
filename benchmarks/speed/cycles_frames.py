"""Frames of Cycles, for `benchmarks.speed.cycles`; runs in an interpreter that has `bpy`.

PYTHON cycles_frames.py SCENE.npz IMAGES.npz
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import bpy  # pyright: ignore[reportMissingImports]
import numpy as np

UNIT = 1e3
"""Units of the scene per meter: Cycles' margins are made for lengths about 1."""


def main(scene_file: str, images_file: str) -> None:
    """Render every seed, write images and times."""
    given = np.load(scene_file)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    _set_up(scene, given)
    _add_wall(scene, given)
    for place, intensity in zip(given["leds"], given["intensities"], strict=True):
        _add_led(scene, place * UNIT, intensity * UNIT**2)
    _add_camera(scene, given)
    times, images, started = [], [], []
    bpy.app.handlers.render_pre.append(lambda *_: started.append(_clocks()))
    bpy.app.handlers.render_post.append(lambda *_: times.append(_clocks() - started.pop()))
    with tempfile.TemporaryDirectory() as folder:
        scene.render.filepath = os.path.join(folder, "frame.exr")
        for seed in range(int(given["images"])):
            scene.cycles.seed = seed
            bpy.ops.render.render(write_still=True)
            images.append(_read(scene.render.filepath, int(given["size"])))
    version = bpy.app.version_string
    np.savez(images_file, images=np.stack(images), times=np.stack(times), version=version)


def _clocks() -> np.ndarray:
    """Processor time and time [s]."""
    return np.array([time.process_time(), time.perf_counter()])


def _set_up(scene: Any, given: Any) -> None:
    scene.render.engine = "CYCLES"
    scene.render.resolution_x = scene.render.resolution_y = int(given["size"])
    scene.render.resolution_percentage = 100
    scene.render.threads_mode, scene.render.threads = "FIXED", int(given["threads"])
    scene.render.use_persistent_data = True
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    scene.view_settings.view_transform = "Raw"
    cycles = scene.cycles
    cycles.device, cycles.samples = "CPU", int(given["spp"])
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0
    cycles.light_sampling_threshold = 0.0
    # Rays through the middle of pixels.
    cycles.pixel_filter_type, cycles.filter_width = "BOX", 0.01
    # Bounces after the first reflection.
    cycles.max_bounces = cycles.diffuse_bounces = int(given["max_bounces"]) - 1


def _add_wall(scene: Any, given: Any) -> None:
    mesh = bpy.data.meshes.new("wall")
    mesh.from_pydata((given["vertices"] * UNIT).tolist(), [], given["faces"].tolist())
    mesh.polygons.foreach_set("use_smooth", np.ones(len(given["faces"]), bool))
    mesh.normals_split_custom_set_from_vertices(given["normals"].tolist())
    wall = bpy.data.objects.new("wall", mesh)
    material = bpy.data.materials.new("wall")
    material.use_nodes = True
    nodes = material.node_tree.nodes
    nodes.clear()
    diffuse, output = nodes.new("ShaderNodeBsdfDiffuse"), nodes.new("ShaderNodeOutputMaterial")
    diffuse.inputs["Color"].default_value = (*given["albedo"].tolist(), 1.0)
    material.node_tree.links.new(diffuse.outputs["BSDF"], output.inputs["Surface"])
    mesh.materials.append(material)
    scene.collection.objects.link(wall)


def _add_led(scene: Any, place: np.ndarray, intensity: np.ndarray) -> None:
    """A point whose power is 4π of its radiant intensity."""
    light = bpy.data.lights.new("led", "POINT")
    light.shadow_soft_size = 0.0
    light.energy = 4.0 * np.pi * float(intensity.max())
    light.color = (intensity / intensity.max()).tolist()
    led = bpy.data.objects.new("led", light)
    led.location = place.tolist()
    scene.collection.objects.link(led)


def _add_camera(scene: Any, given: Any) -> None:
    """Blender's cameras look along −z with y up."""
    from mathutils import Matrix  # pyright: ignore[reportMissingImports]

    camera = bpy.data.cameras.new("eye")
    camera.angle, camera.clip_start, camera.clip_end = float(given["field"]), 1e-3, 1e5
    eye = bpy.data.objects.new("eye", camera)
    pose = given["T_world_camera"] @ np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] *= UNIT
    eye.matrix_world = Matrix(pose.tolist())
    scene.collection.objects.link(eye)
    scene.camera = eye


def _read(path: str, size: int) -> np.ndarray:
    """Linear radiance [h w 3]; Blender's row 0 is the lowest."""
    image = bpy.data.images.load(path)
    image.colorspace_settings.name = "Non-Color"
    values = np.empty(size * size * 4, np.float32)
    image.pixels.foreach_get(values)
    bpy.data.images.remove(image)
    Path(path).unlink()
    return values.reshape(size, size, 4)[::-1, :, :3]


if __name__ == "__main__":
    main(*sys.argv[1:])
