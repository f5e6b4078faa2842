"""Simulated frames for each class of real frames: organs, lesions, cameras, views."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

import vrcaps
from docs.images.lesions import best_view, even_exposure
from vrcaps import _core
from vrcaps.camera.camera import Camera, Led
from vrcaps.camera.lens.wide_angle import LensEquidistant
from vrcaps.capsule.device import Device
from vrcaps.core.transforms import invert, look_along, transform_from
from vrcaps.core.units import DEG, MM
from vrcaps.lesion import add_lesions, parse_lesion
from vrcaps.lumen.contents import Contents, prepared
from vrcaps.organ.surface import OrganSurface
from vrcaps.world.model import Model, State

SIDE_PX = 256
SETTINGS = vrcaps.RenderSettings(supersampling=2, shadows=True, light="radiosity")
CHANNELS = ("radiance", "ray_distance", "foreground_label", "foreground_depth")
"""Requirements of the cameras of the comparison."""
CONTENTS = (Contents(), Contents(bubbles=2, chyme=1, liquid=1))
"""In the small bowel: every second frame has some."""
PREPARED = (prepared(3), prepared(2))
"""In the colon: every second frame is of one cleansed well, the others less so."""
POLYPS = tuple(f"polyp-{shape}:pattern={pattern},size={size}mm"
    for shape, pattern, size in (
        *(("Ip", "tubular", 14), ("Is", "hyperplastic", 6), ("IIa", "serrated", 12)),
        *(("Is", "villous", 16), ("IIb", "tubular", 10), ("IIc", "tubular", 12)),
    )
)  # fmt: skip
COLITIS = {1: "ascending", 2: "transverse", 3: "descending"}
BLEEDS = ("bleeding-1", "bleeding-2", "bleeding-3", "bleeding-4")


def colonoscope(side_px: int = SIDE_PX) -> Device:
    """Tip of a video colonoscope: a field of 140° and two light guides next to the lens.

    Field of view as makers state it for standard colonoscopes; the guides' places are assumed.
    """
    half = 0.5 * side_px
    camera = Camera(
        name="front",
        lens=LensEquidistant(half / (70 * DEG), half - 0.5, half - 0.5, 70 * DEG),
        width=side_px,
        height=side_px,
        leds=tuple(Led((x * MM, -2 * MM, 0.0)) for x in (-3.5, 3.5)),
        exposure=1.0,
        image_circle_px=half,
    )
    return replace(vrcaps.read_device("mirocam"), name="colonoscope", cameras=(camera,))


@dataclass(frozen=True)
class Shot:
    """Frame with `CHANNELS`, its state and its renderer."""

    frame: vrcaps.Frame
    state: State
    renderer: vrcaps.Renderer

    @property
    def camera(self) -> Camera:
        """Camera of the view."""
        return self.renderer.model.device.cameras[0]


Scene = tuple[Model, list[State]]
"""A world and the places to look from."""


def scenes(name: str, patients: int, frames: int) -> Iterator[Scene]:
    """Simulated scenes that correspond to a class of real frames.

    Args:
        name: Folder of the real frames.
        patients: Seeds 0, 1, …
        frames: Of each patient, about.
    """
    for seed in range(patients):
        yield from views(name, seed, frames, np.random.default_rng([seed, 77]))


def shots(chosen: Iterable[Scene], settings: vrcaps.RenderSettings = SETTINGS) -> Iterator[Shot]:
    """Frames of scenes."""
    for model, states in chosen:
        renderer = vrcaps.Renderer(model, settings)
        for state in states:
            frame = renderer.render(state, model.device.cameras[0], channels=CHANNELS)
            yield Shot(frame, state, renderer)


def views(name: str, seed: int, frames: int, rng: np.random.Generator) -> Iterator[Scene]:
    """Organs of one patient, and camera positions."""
    capsule, colonoscopy = vrcaps.read_device("pillcam-sb3"), colonoscope()
    if name == "clean_colon":
        organ = vrcaps.generate_organ("colon", seed=seed)
        yield from filled(flight(organ, colonoscope(360), (0.03, 0.97), frames, rng), PREPARED)
    elif name == "capsule_non_bleeding":
        # Around a capsule the small bowel is not inflated.
        organ = vrcaps.generate_organ("small-bowel", seed=seed, distension="collapsed")
        yield from filled(flight(organ, capsule, (0.02, 0.98), frames, rng), CONTENTS)
    elif name == "capsule_bleeding":
        yield at_lesions("small-bowel", seed, BLEEDS, capsule, rng)
    elif name == "polyp":
        yield from filled(at_lesions("colon", seed, POLYPS, colonoscopy, rng), PREPARED)
    else:
        sick = ill_colon(seed)
        record = sick.metadata["lesions"][int(name[-1]) - 1]
        middle = record["arc_length_m"] / sick.centerline.length
        stretch = (middle - 0.06, middle + 0.06)
        yield from filled(flight(sick, colonoscopy, stretch, frames, rng), PREPARED)


def filled(scene: Scene, kinds: tuple[Contents, ...]) -> Iterator[Scene]:
    """Scene with lumen contents: its views cycle through the kinds of contents."""
    model, states = scene
    for k, contents in enumerate(kinds):
        yield replace(model, contents=contents), states[k :: len(kinds)]


@cache
def ill_colon(seed: int) -> OrganSurface:
    """A colon with a stretch of colitis of each grade, Mayo 1, 2, 3."""
    texts = [f"colitis-{mayo}:spread=30cm,segment={at}" for mayo, at in COLITIS.items()]
    organ = vrcaps.generate_organ("colon", seed=seed)
    lesions = [parse_lesion(text) for text in texts]
    return add_lesions(organ, lesions, np.random.default_rng([seed, 78])).organ


def flight(
    organ: OrganSurface,
    device: Device,
    stretch: tuple[float, float],
    frames: int,
    rng: np.random.Generator,
) -> Scene:
    """Views at equal distances along a stretch of the lumen, some of them towards the wall."""
    model = Model(organ, device)
    low, high = np.clip(stretch, 0.01, 0.99)
    settings = vrcaps.FlyThrough(start=low, end=high, whole=True, tilt=0.78, drift=0.6)
    path = vrcaps.fly_through(model, settings, frames=frames, fps=1.0, rng=rng)
    return model, [path.state(k) for k in range(frames)]


def at_lesions(
    name: str, seed: int, texts: tuple[str, ...], device: Device, rng: np.random.Generator
) -> Scene:
    """Best view of each lesion of a patient."""
    lesions = [parse_lesion(text) for text in texts]
    organ = add_lesions(vrcaps.generate_organ(name, seed=seed), lesions, rng).organ
    model, camera = Model(organ, device), device.cameras[0]
    wall = Model(organ, device, np.eye(4)).wall
    states = []
    for record in organ.metadata["lesions"]:
        eye, target = best_view(organ, wall, record["instance"], camera)
        pose = transform_from(look_along(target - eye, rng.normal(size=3)), eye)
        # The camera, not the capsule's middle, is where the lesion is seen from.
        states.append(State(0.0, model.T_world_patient @ pose @ invert(camera.T_capsule_camera)))
    return model, states


def exposed(radiance: np.ndarray, mean_luminance: float) -> np.ndarray:
    """SRGB with the exposure that an automatic control would choose, see `even_exposure`."""
    exposure = even_exposure(radiance, mean_luminance)
    return _core.encode_srgb(np.ascontiguousarray(radiance, np.float32), exposure)
