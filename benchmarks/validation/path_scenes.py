"""Scenes of the path-tracing scripts: lumens lit by point LEDs, also for Mitsuba 3."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.common.scripts import ROOT
from benchmarks.speed.peers.mitsuba import VARIANT, use_working_llvm
from vrcaps.anatomy.catalog import generate_organ
from vrcaps.camera.camera import Camera
from vrcaps.camera.lens import LensPinhole
from vrcaps.capsule.device_file import read_device
from vrcaps.motion.fly_through import FlyThrough, fly_through
from vrcaps.organ.surface import OrganSurface
from vrcaps.render.renderer import Renderer
from vrcaps.render.settings import RenderSettings
from vrcaps.world.model import Model, State

assert (ROOT / "tests").is_dir()
FIELD = 2.0
"""Full field of view [rad]."""


@dataclass(frozen=True)
class Scene:
    """Lumen and camera pose.

    Attributes:
        name: For tables.
        model: The lumen; its textures are coarse, for Mitsuba's rays have no footprint.
        camera: A pinhole camera with the LEDs of MiroCam, alike in all directions.
        state: State with the pose of the capsule.
    """

    name: str
    model: Model
    camera: Camera
    state: State

    def ours(
        self, *, max_bounces: int, spp: int, denoise: bool = False
    ) -> Callable[[int], np.ndarray]:
        """Render linear radiance [h w 3] of a seed."""

        def image(seed: int) -> np.ndarray:
            settings = RenderSettings(
                light="path", spp=spp, max_bounces=max_bounces, path_seed=seed, denoise=denoise
            )
            renderer.settings = settings
            radiance = renderer.render(self.state, self.camera, channels=("radiance",)).radiance
            assert radiance is not None
            return radiance.astype(float)

        renderer = Renderer(self.model)
        return image

    def theirs(self, *, max_bounces: int, spp: int) -> Callable[[int], np.ndarray]:
        """Render linear radiance by Mitsuba's `path`, compiled by LLVM."""
        import mitsuba as mi

        from tests.support.oracle_mitsuba import compiled_path_light

        mi.set_variant(VARIANT)
        return compiled_path_light(
            self.model, self.camera, self.state, max_bounces=max_bounces, spp=spp
        )


def scenes(size: int) -> Iterator[Scene]:
    """A tube with ring folds, a generated colon, with bare facets, made smooth; other organs."""
    from tests.support.shapes import looking, patterned, pinhole, tube

    use_working_llvm()
    look = replace(patterned(np.random.default_rng(1)), ior=1.4, clearcoat=0.7, clearcoat_gloss=0.0)
    device = read_device("mirocam")
    lens, width, height = pinhole(size, FIELD)
    assert isinstance(lens, LensPinhole)
    leds = tuple(replace(led, lobe_exponent=0.0) for led in device.cameras[0].leds)
    camera = replace(
        device.cameras[0], lens=lens, width=width, height=height, leds=leds, image_circle_px=None
    )
    folded = tube(200, 640, length=0.15, folds=0.35, capped=True, appearance=look)
    model = Model(folded, device, np.eye(4))
    yield Scene("ring folds", model, camera, looking((0.004, -0.003, 0.04)))
    colon = replace(generate_organ("colon", seed=0), appearance=look)
    model = Model(colon, device)
    rng = np.random.default_rng(0)
    state = fly_through(model, FlyThrough(whole=True), frames=3, fps=1.0, rng=rng).state(1)
    yield Scene("generated colon", model, camera, state)
    yield Scene("the same, flat faces", Model(_flat(colon), device), camera, state)
    yield Scene("the same, smooth", Model(_smooth(colon), device), camera, state)
    for name in ("stomach", "small-bowel"):
        organ = generate_organ(name, seed=11)
        state = fly_through(
            Model(organ, device), FlyThrough(whole=True), frames=3, fps=1.0, rng=rng
        ).state(1)
        state = replace(state, vertices_world=None)  # nothing that a narrow wall gives way
        organ = _flat(replace(organ, appearance=look))
        yield Scene(f"{name}, held out, flat faces", Model(organ, device), camera, state)


def _flat(organ: OrganSurface) -> OrganSurface:
    """Triangles without common vertices, so that normals are those of the faces."""
    from tests.support.shapes import make_organ

    vertices = organ.vertices[organ.faces].reshape(-1, 3)
    faces = np.arange(len(vertices)).reshape(-1, 3)
    return make_organ(vertices, faces, uv=organ.uv, appearance=organ.appearance)


def _smooth(organ: OrganSurface) -> OrganSurface:
    """Loop subdivision into 16 triangles each, so that normals and faces agree.

    If a smooth normal faces away from a ray, Mitsuba loses the light and vrcaps bends the normal.
    """
    import trimesh

    from tests.support.shapes import make_organ

    vertices, faces = trimesh.remesh.subdivide_loop(organ.vertices, organ.faces, iterations=2)
    along_uv = np.array([[15.0, 0.0, 5.0], [0.0, 15.0, -10.0]])  # turns per meter
    return make_organ(
        vertices, faces, uv=(vertices @ along_uv.T)[faces], appearance=organ.appearance
    )
