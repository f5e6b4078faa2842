"""Claim: direct light is correct.

Renders linear radiance, also by Mitsuba 3: same mesh, textures, lights and rays, its principled
BSDF, direct light. Claimed: relative RMSE at most 1 % diffuse, 2 % with specular and clearcoat,
with shadows on and off. Textures are coarse, so that no pixel averages texels: Mitsuba's ray has no
footprint.

    python -m benchmarks.validation.light
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.common.scripts import options, table, write_section
from vrcaps.anatomy.catalog import generate_organ
from vrcaps.capsule.device_file import read_device
from vrcaps.motion.fly_through import FlyThrough, fly_through
from vrcaps.organ.surface import Appearance, OrganSurface
from vrcaps.render.renderer import Renderer
from vrcaps.render.settings import RenderSettings
from vrcaps.world.model import Model, State

FIELD = 2.0
"""Full field of view [rad]."""
WALLS = {
    "diffuse": {"ior": 1.0001, "clearcoat": 0.0},
    "specular and clearcoat": {"ior": 1.4, "clearcoat": 0.7},
}
LIGHTS = {"point": 0.0, "Lambertian": 1.0}
HEAD = (
    "scene", "LEDs", "wall", "shadows", "pixels", "relative RMSE", "median", "99 %", "mean ratio",
    "left out at outlines", "claimed",
)  # fmt: skip
CLAIM = {"diffuse": 0.01, "specular and clearcoat": 0.02}


@dataclass(frozen=True)
class Scene:
    """Lumen and camera pose."""

    name: str
    organ: OrganSurface
    state: State
    T_world_patient: np.ndarray


def scenes() -> Iterator[Scene]:
    """A convex cavity, a tube with ring folds, and a generated colon."""
    from tests.support.shapes import looking, sphere, tube

    yield Scene("sphere", sphere(5), looking((0.004, -0.003, 0.003)), np.eye(4))
    folded = tube(120, 320, length=0.15, folds=0.35, capped=True)
    yield Scene("ring folds", folded, looking((0.004, -0.003, 0.04)), np.eye(4))
    model = Model(generate_organ("colon", seed=0), read_device("mirocam"))
    rng = np.random.default_rng(0)
    run = fly_through(model, FlyThrough(whole=True), frames=3, fps=1.0, rng=rng)
    yield Scene("generated colon", model.organ, run.state(1), model.T_world_patient)


def compare(scene: Scene, size: int, light: str, wall: str, look: Appearance) -> list[tuple]:
    """Rows of the table: shadows off (on pixels that every LED reaches) and on."""
    from tests.support.oracle_mitsuba import direct_light
    from tests.support.shapes import pinhole

    device = read_device("mirocam")
    lens, width, height = pinhole(size, FIELD)
    leds = tuple(replace(led, lobe_exponent=LIGHTS[light]) for led in device.cameras[0].leds)
    camera = replace(
        device.cameras[0], lens=lens, width=width, height=height, leds=leds, image_circle_px=None
    )
    organ = replace(scene.organ, appearance=replace(look, **WALLS[wall]))
    model = Model(organ, device, scene.T_world_patient)
    theirs = direct_light(model, camera, scene.state)
    off, on = (
        Renderer(model, RenderSettings(light="direct", shadows=shadows)).render(
            scene.state, camera, channels=("radiance", "depth")
        )
        for shadows in (False, True)
    )
    assert off.radiance is not None
    assert on.radiance is not None
    seen = np.isfinite(off.depth)
    free = seen & np.all(off.radiance == on.radiance, axis=-1)
    names = (scene.name, light, wall)
    return [
        (*names, "off", *figures(off.radiance[free], theirs[free], CLAIM[wall])),
        (*names, "on", *figures(on.radiance[seen], theirs[seen], CLAIM[wall])),
    ]


def figures(ours: np.ndarray, theirs: np.ndarray, claim: float) -> tuple[str, ...]:
    """Errors over pixels [n 3].

    Relative RMSE is the root of the mean squared difference over the mean radiance. Median, 99 %
    and the mean ratio are of pixels brighter than 1 % of the brightest. At an outline a smooth
    normal can point away from the camera: Mitsuba leaves such a pixel black, here the normal is
    bent to the horizon; these pixels count in no error, and their share is given.
    """
    bent = (theirs.max(axis=1) == 0.0) & (ours.max(axis=1) > 0.0)
    ours, theirs = ours[~bent], theirs[~bent]
    rmse = np.sqrt(np.mean((ours - theirs) ** 2)) / theirs.mean()
    lit = theirs.max(axis=1) > 0.01 * theirs.max()
    ratio = ours[lit].sum(axis=1) / theirs[lit].sum(axis=1)
    middle, high = np.quantile(np.abs(ratio - 1.0), (0.5, 0.99))
    return (
        f"{len(bent):,}",
        f"{100 * rmse:.3f} %",
        f"{100 * middle:.3f} %",
        f"{100 * high:.2f} %",
        f"{ratio.mean():.5f}",
        f"{100 * bent.mean():.3f} %",
        f"≤ {100 * claim:g} %: {'yes' if rmse <= claim else 'NO'}",
    )


def main() -> None:
    """Compare, write the table."""
    given = options(__doc__ or "", size=160)
    from tests.support.shapes import patterned

    look = patterned(np.random.default_rng(1))
    rows = []
    for scene, wall, light in itertools.product(scenes(), WALLS, LIGHTS):
        rows += compare(scene, given.size, light, wall, look)
        print(*rows[-2:], sep="\n", flush=True)
    text = (
        "## Light\n\n`python -m benchmarks.validation.light`: linear radiance against Mitsuba 3 "
        f"(`scalar_rgb`, `direct`,\n`principled`), {given.size} × {given.size} pixels, the six "
        "LEDs of MiroCam,\nrandom coarse textures of color, rounded as our texels are, and of "
        "roughness.\n\n"
        + table(HEAD, rows)
        + "\n\nRelative RMSE: root mean square difference, divided by the mean radiance. Median, "
        "99 % and mean ratio: of\neach pixel brighter than 1 % of the brightest. *Shadows off* "
        "compares the pixels that every LED reaches,\nbecause Mitsuba always casts shadows."
    )
    write_section(given.out, Path(__file__), text)


if __name__ == "__main__":
    main()
