"""Draw the picture of light through tissue: one place of a generated colon, in three ways.

python -m docs.images.tissue
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

import vrcaps
from vrcaps.camera.derive import scaled_camera

ORGANS = ("colon",)
WAYS = {
    "radiosity": vrcaps.RenderSettings(light="radiosity", shadows=True),
    "radiosity, scattering": vrcaps.RenderSettings(
        light="radiosity", shadows=True, scattering=True
    ),
    "path, scattering": vrcaps.RenderSettings(
        light="path", spp=400, max_bounces=10, scattering=True
    ),
}
SIDE_PX = 320
VIEW = 0.5
"""Pixels to a side, over MiroCam's 320."""


def row(name: str) -> np.ndarray:
    """A generated organ in all ways."""
    model = vrcaps.Model(vrcaps.generate_organ(name, seed=0), vrcaps.read_device("mirocam"))
    rng = np.random.default_rng(0)
    flight = vrcaps.fly_through(model, vrcaps.FlyThrough(whole=True), frames=20, fps=3.0, rng=rng)
    camera, cells = scaled_camera(model.device.cameras[0], VIEW), []
    for title, settings in WAYS.items():
        renderer = vrcaps.Renderer(model, settings)
        frame = renderer.render(flight.state(9), camera, channels=("rgb",))
        image = Image.fromarray(np.asarray(frame.rgb))
        image = image.resize((SIDE_PX, SIDE_PX), Image.Resampling.LANCZOS)
        ImageDraw.Draw(image).text((8, 6), title, fill="white")
        cells.append(np.asarray(image))
    return np.hstack(cells)


def main(path: Path) -> None:
    """One organ below the other, one way beside the other."""
    Image.fromarray(np.vstack([row(name) for name in ORGANS])).save(path, quality=88)


if __name__ == "__main__":
    main(Path(__file__).with_suffix(".jpg"))
