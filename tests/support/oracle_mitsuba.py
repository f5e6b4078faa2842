"""Mitsuba 3 as an independent renderer: same mesh, texture, lights and rays."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from vrcaps.camera.camera import Camera, Led, camera_rays
from vrcaps.core.geometry import rotate_vectors
from vrcaps.organ.surface import Appearance
from vrcaps.world.model import Model, State

_SCALE = 1e3
"""Mitsuba's units per meter: its shadow rays start (1 + |p|) 9e-5 units off the surface."""
_DIRECT = {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0, "hide_emitters": True}
_LED_RADIUS = 2e-6 * _SCALE
"""Radius of the disk that stands for a Lambertian LED."""


def direct_light(model: Model, camera: Camera, state: State) -> np.ndarray:
    """Linear radiance [h w 3], with shadows; zero where no wall is met.

    Every LED is rendered by itself with one sample, which for lights this small is exact: no
    random number matters.
    """
    import mitsuba as mi

    # The scalar variant needs no LLVM; those of Debian cannot compile the principled model.
    mi.set_variant("scalar_rgb")
    T_world_camera = state.T_world_capsule @ camera.T_capsule_camera
    rays = rotate_vectors(T_world_camera, camera_rays(camera).astype(float)).reshape(-1, 3)
    seen = np.isfinite(rays[:, 0])
    mesh = _mesh(model, state, T_world_camera[:3, 3])
    radiance = np.zeros((len(rays), 3))
    for led in camera.leds:
        scene = mi.load_dict({"type": "scene", "wall": mesh, "led": _led(led, T_world_camera)})
        radiance[seen] += _trace(scene, rays[seen], _DIRECT)
    return radiance.reshape(camera.height, camera.width, 3)


def path_light(
    model: Model, camera: Camera, state: State, *, max_bounces: int, spp: int
) -> np.ndarray:
    """Linear radiance [spp h w 3] of `spp` paths of up to `max_bounces` reflections a pixel.

    LEDs have lobes of exponent 0.
    """
    import mitsuba as mi

    mi.set_variant("scalar_rgb")
    scene, rays = _lit(model, camera, state)
    images = [_trace(scene, rays, _paths(max_bounces), seed=k) for k in range(spp)]
    return np.stack(images).reshape(spp, camera.height, camera.width, 3)


def compiled_path_light(
    model: Model, camera: Camera, state: State, *, max_bounces: int, spp: int
) -> Callable[[int], np.ndarray]:
    """The same by the variant that is set, of `llvm_…`: makes images [h w 3] of a seed.

    No film and no sensor: the integrator on our ray table. Every lens ray must be one.
    """
    import drjit as dr
    import mitsuba as mi

    scene, rays = _lit(model, camera, state)
    integrator, sampler = mi.load_dict(_paths(max_bounces)), mi.load_dict({"type": "independent"})
    repeated = np.repeat(rays, spp, axis=0).astype(np.float32)
    directions = mi.Vector3f(np.ascontiguousarray(repeated.T))
    pixel = dr.arange(mi.UInt32, len(repeated)) // spp

    def image(seed: int) -> np.ndarray:
        sampler.seed(seed, len(repeated))
        ray = mi.RayDifferential3f(mi.Ray3f(mi.Point3f(0.0), directions))
        radiance = integrator.sample(scene, sampler, ray)[0]
        sums = [dr.zeros(mi.Float, len(rays)) for _ in range(3)]
        for total, channel in zip(sums, radiance, strict=True):
            dr.scatter_reduce(dr.ReduceOp.Add, total, channel, pixel)
        dr.eval(sums)
        dr.sync_thread()
        mean = np.stack([np.array(total) for total in sums], axis=1) / spp
        return mean.reshape(camera.height, camera.width, 3)

    return image


def _paths(max_bounces: int) -> dict[str, Any]:
    return {"type": "path", "max_depth": max_bounces + 1, "rr_depth": max_bounces + 1}


def _lit(model: Model, camera: Camera, state: State) -> tuple[Any, np.ndarray]:
    """The scene about the camera with all LEDs, and ray directions [h·w 3]."""
    import mitsuba as mi

    T_world_camera = state.T_world_capsule @ camera.T_capsule_camera
    rays = rotate_vectors(T_world_camera, camera_rays(camera).astype(float)).reshape(-1, 3)
    leds = {f"led{k}": _led(led, T_world_camera) for k, led in enumerate(camera.leds)}
    wall = _mesh(model, state, T_world_camera[:3, 3])
    return mi.load_dict({"type": "scene", "wall": wall, **leds}), rays


def _to_local(points_world: np.ndarray, eye: np.ndarray) -> np.ndarray:
    """Mitsuba's coordinates: about the camera, so that positions and its margins are small."""
    return (points_world - eye) * _SCALE


def _trace(scene: Any, rays: np.ndarray, settings: dict[str, Any], seed: int = 0) -> np.ndarray:
    import mitsuba as mi

    integrator, sampler = mi.load_dict(settings), mi.load_dict({"type": "independent"})
    sampler.seed(seed, 1)
    start = mi.Point3f(0.0, 0.0, 0.0)
    result = np.empty((len(rays), 3))
    for number, ray in enumerate(rays.tolist()):
        result[number] = integrator.sample(scene, sampler, mi.RayDifferential3f(start, ray))[0]
    return result


def _mesh(model: Model, state: State, eye: np.ndarray) -> Any:
    """The wall with smooth normals; corners of faces are vertices, as texture coordinates ask."""
    import mitsuba as mi

    organ = model.organ
    vertices = model.vertices_world if state.vertices_world is None else state.vertices_world
    normals = rotate_vectors(model.T_world_patient, organ.normals)
    count = organ.faces.size
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(_bsdf(organ.appearance))
    mesh = mi.Mesh(
        "wall",
        count,
        len(organ.faces),
        has_vertex_normals=True,
        has_vertex_texcoords=True,
        props=properties,
    )
    uv = organ.uv.reshape(-1, 2) * [1.0, -1.0] + [0.0, 1.0]  # Mitsuba's row 0 is v = 0
    parameters = mi.traverse(mesh)
    for name, values in (
        ("vertex_positions", _to_local(vertices, eye)[organ.faces]),
        ("vertex_normals", normals[organ.faces]),
        ("vertex_texcoords", uv),
    ):
        parameters[name] = values.astype(np.float32).ravel()
    parameters["faces"] = np.arange(count, dtype=np.uint32)
    parameters.update()
    return mesh


def _bsdf(look: Appearance | None) -> dict[str, Any]:
    assert look is not None
    color = look.albedo / 255.0
    linear = np.where(color <= 0.04045, color / 12.92, ((color + 0.055) / 1.055) ** 2.4)
    return {
        "type": "principled",
        "base_color": _bitmap(stored_color(linear)),
        "roughness": _bitmap(look.roughness[..., None] / 255.0),
        "eta": look.ior,
        "clearcoat": look.clearcoat,
        "clearcoat_gloss": look.clearcoat_gloss,
    }


def stored_color(linear: np.ndarray) -> np.ndarray:
    """Linear color as a texel of the renderer holds it: square roots in 11, 11 and 10 bits.

    Both look at the same wall then, and their difference is that of light transport alone.
    """
    steps = np.array([2047.0, 2047.0, 1023.0])
    return (np.round(np.sqrt(linear) * steps) / steps) ** 2


def _bitmap(values: np.ndarray) -> dict[str, Any]:
    import mitsuba as mi

    return {
        "type": "bitmap",
        "data": mi.TensorXf(values.astype(np.float32)),
        "raw": True,
        "filter_type": "bilinear",
        "wrap_mode": "repeat",
        "format": "variant",
    }


def _led(led: Led, T_world_camera: np.ndarray) -> dict[str, Any]:
    """A point light for a lobe of exponent 0, a tiny Lambertian disk for exponent 1."""
    import mitsuba as mi

    place = rotate_vectors(T_world_camera, np.array([led.position_camera]))[0] * _SCALE
    if led.lobe_exponent == 0.0:
        intensity = {"type": "rgb", "value": (np.array(led.intensity) * _SCALE**2).tolist()}
        return {"type": "point", "position": place.tolist(), "intensity": intensity}
    assert led.lobe_exponent == 1.0, "Mitsuba has no light with this lobe"
    axis = rotate_vectors(T_world_camera, np.array([led.direction_camera]))[0]
    radiance = np.array(led.intensity) * _SCALE**2 / (np.pi * _LED_RADIUS**2)
    up = np.eye(3)[np.argmin(np.abs(axis))]
    transform = mi.ScalarTransform4f
    to_world = transform().look_at(
        origin=place.tolist(), target=(place + axis).tolist(), up=up.tolist()
    ) @ transform().scale(_LED_RADIUS)
    emitter = {"type": "area", "radiance": {"type": "rgb", "value": radiance.tolist()}}
    return {"type": "disk", "to_world": to_world, "emitter": emitter}
