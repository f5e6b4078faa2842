"""Mitsuba 3, compiled by LLVM: direct light and the channels its `aov` integrator offers."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.speed.peers import PeerMissingError, led_positions, load_package, welded_mesh
from vrcaps.camera.camera import camera_rays
from vrcaps.cli.benchmarks.report import Subject
from vrcaps.cli.benchmarks.stage import Stage

RENDER = "Mitsuba, direct + AOV"
BARE = "Mitsuba, direct + AOV, no film, frozen"

VARIANT = "llvm_ad_rgb"
_LIBRARY = "DRJIT_LIBLLVM_PATH"
_FIELD_DEG = 100.0
_OLDEST_LLVM = 16
"""LLVM 15 cannot select instructions for some of Mitsuba's AVX-512 kernels, and aborts."""

_DIRECT = {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0}
_BOTH = {"type": "aov", "aovs": "z:depth,n:sh_normal,p:position,t:uv", "image": _DIRECT}
_PROBE = f"""
import mitsuba as mi
mi.set_variant({VARIANT!r})
from drjit.detail import llvm_version
assert llvm_version()[0] >= {_OLDEST_LLVM}
bsdf = {{"type": "principled", "clearcoat": 1.0}}
wall = {{"type": "sphere", "flip_normals": True, "bsdf": bsdf}}
parts = {{"wall": wall, "led": {{"type": "point"}}, "sensor": {{"type": "perspective"}}}}
scene = mi.load_dict({{"type": "scene", **parts}})
print(mi.render(scene, integrator=mi.load_dict({_BOTH!r}), spp=1).numpy().shape)
"""


def subjects(stage: Stage) -> list[Subject]:
    """A frame through `mi.render`, and the same without the overhead of `mi.render`.

    Raises:
        PeerMissingError: If Mitsuba is not installed or finds no LLVM that works.
    """
    use_working_llvm()
    mi = load_package("mitsuba")
    mi.set_variant(VARIANT)
    scene = _scene(mi, stage)
    light = "one sample of one of the 6 LEDs a pixel; no relief; depth, normal, position, uv"
    return [
        Subject(
            RENDER,
            _by_render(mi, scene, stage),
            f"mi.render, 1 spp, perspective of {_FIELD_DEG:.0f}°; {light}",
        ),
        Subject(
            BARE,
            _by_integrator(mi, scene, stage),
            f"the fastest found: integrator on our ray table under drjit.freeze; {light}",
        ),
    ]


def use_working_llvm() -> None:
    """Choose an LLVM library that can compile for this CPU; one that cannot ends the process.

    Raises:
        PeerMissingError: If there is none.
    """
    if find_spec("mitsuba") is None:
        load_package("mitsuba")
    if _LIBRARY in os.environ:
        candidates: list[str | None] = [os.environ[_LIBRARY]]
    else:
        candidates = [None, *_rust_llvm()]
    for library in candidates:
        environment = os.environ | ({} if library is None else {_LIBRARY: library})
        probe = subprocess.run(
            [sys.executable, "-c", _PROBE], env=environment, capture_output=True, check=False
        )
        if probe.returncode == 0:
            # Dr.Jit reads it when Mitsuba is first imported, so not before here.
            os.environ.update({} if library is None else {_LIBRARY: library})
            return
    raise PeerMissingError(
        f"Mitsuba's LLVM variant does not run with the LLVM found; install LLVM {_OLDEST_LLVM} "
        f"or newer, or name its libLLVM.so in {_LIBRARY}"
    )


def _rust_llvm() -> list[str]:
    """LLVM libraries that came with the Rust compiler."""
    try:
        answer = subprocess.run(
            ["rustc", "--print", "sysroot"], capture_output=True, text=True, check=True
        )
    except (OSError, subprocess.CalledProcessError):
        return []
    return [str(path) for path in Path(answer.stdout.strip(), "lib").glob("libLLVM.so.*")]


def _scene(mi: Any, stage: Stage) -> Any:
    contents = {
        "type": "scene",
        "wall": _wall(mi, stage),
        "sensor": {
            "type": "perspective",
            "fov": _FIELD_DEG,
            "near_clip": 1e-4,
            "film": {
                "type": "hdrfilm",
                "width": stage.camera.width,
                "height": stage.camera.height,
                "rfilter": {"type": "box"},
            },
            "sampler": {"type": "independent"},
        },
    }
    for k, led in enumerate(stage.camera.leds):
        intensity = {"type": "rgb", "value": list(led.intensity)}
        contents[f"led{k}"] = {"type": "point", "position": [0, 0, 0], "intensity": intensity}
    return mi.load_dict(contents)


def _wall(mi: Any, stage: Stage) -> Any:
    mesh, look = welded_mesh(stage), stage.model.organ.appearance
    assert look is not None
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(
        {
            "type": "principled",
            "base_color": {"type": "bitmap", "bitmap": mi.Bitmap(look.albedo)},
            "roughness": {
                "type": "bitmap",
                "bitmap": mi.Bitmap(look.roughness[..., None]),
                "raw": True,
            },
            "eta": look.ior,
            "clearcoat": look.clearcoat,
            "clearcoat_gloss": look.clearcoat_gloss,
        }
    )
    wall = mi.Mesh(
        "wall",
        len(mesh.vertices),
        len(mesh.faces),
        props=properties,
        has_vertex_normals=True,
        has_vertex_texcoords=True,
    )
    parameters = mi.traverse(wall)
    parameters["vertex_positions"] = mesh.vertices.astype(np.float32).ravel()
    parameters["vertex_normals"] = mesh.normals.astype(np.float32).ravel()
    parameters["vertex_texcoords"] = mesh.uv.astype(np.float32).ravel()
    parameters["faces"] = mesh.faces.astype(np.uint32).ravel()
    parameters.update()
    return wall


def _by_render(mi: Any, scene: Any, stage: Stage) -> Any:
    import drjit as dr

    integrator, parameters = mi.load_dict(_BOTH), mi.traverse(scene)
    # Mitsuba's sensors look along +z with x left and y up.
    flip = np.diag([-1.0, -1.0, 1.0, 1.0])
    poses = [mi.Transform4f(T @ flip) for T in stage.Ts_world_camera()]
    leds = _points(mi, stage)

    def frame(view: int) -> object:
        parameters["sensor.to_world"] = poses[view]
        _place_leds(parameters, leds[view])
        parameters.update()
        image = mi.render(scene, integrator=integrator, spp=1, seed=view)
        dr.eval(image)
        dr.sync_thread()
        return image

    return frame


def _by_integrator(mi: Any, scene: Any, stage: Stage) -> Any:
    import drjit as dr

    integrator, parameters = mi.load_dict(_BOTH), mi.traverse(scene)
    sampler = mi.load_dict({"type": "independent"})
    rays = camera_rays(stage.camera).reshape(-1, 3)
    rays = rays[np.isfinite(rays).all(axis=1)]
    directions = mi.Vector3f(np.ascontiguousarray(rays.T))
    poses = [mi.Transform4f(T) for T in stage.Ts_world_camera()]
    leds = _points(mi, stage)

    @dr.freeze
    def sample(scene: Any, pose: Any, directions: Any, seed: Any) -> Any:
        sampler.seed(seed, len(rays))
        ray = mi.Ray3f(mi.Point3f(pose.translation()), pose @ directions)
        return integrator.sample(scene, sampler, mi.RayDifferential3f(ray))

    def frame(view: int) -> object:
        _place_leds(parameters, leds[view])
        parameters.update()
        channels = sample(scene, poses[view], directions, mi.UInt32(view))
        dr.eval(channels)
        dr.sync_thread()
        return channels

    return frame


def _points(mi: Any, stage: Stage) -> list[list[Any]]:
    return [[mi.Point3f(*place.tolist()) for place in places] for places in led_positions(stage)]


def _place_leds(parameters: Any, places: list[Any]) -> None:
    for k, place in enumerate(places):
        parameters[f"led{k}.position"] = place
