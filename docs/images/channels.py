"""Draw the picture of the front page: views along a generated colon, channel by channel.

python -m docs.images.channels
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image

import vrcaps

CHANNELS = ("rgb", "depth", "normal", "label")
FRAMES, SHOWN = 200, (12, 58, 92, 126, 171, 188)
BRIGHTER = 2.2  # than the exposure that the capsule's file states
GAP_PX = 6


def colors(frame: vrcaps.Frame, channel: str) -> np.ndarray:
    """A channel as an sRGB image, black where the lens sees nothing."""
    seen = frame.label > 0
    if channel == "rgb":
        return frame.rgb
    if channel == "depth":
        near = np.clip(1.0 - frame.depth / 0.09, 0.0, 1.0)
        image = matplotlib.colormaps["magma"](np.nan_to_num(near))[..., :3]
    elif channel == "normal":
        image = 0.5 - 0.5 * np.nan_to_num(frame.normal)
    else:
        image = matplotlib.colormaps["tab10"](frame.label)[..., :3]
    return np.uint8(255.0 * image * seen[..., None] + 0.5)


def main(path: Path) -> None:
    """Render the views and write the picture."""
    organ, device = vrcaps.generate_organ("colon", seed=0), vrcaps.read_device("mirocam")
    camera = device.cameras[0]
    camera = replace(camera, exposure=BRIGHTER * camera.exposure)
    model = vrcaps.Model(organ, device)
    rng = np.random.default_rng(0)
    flight = vrcaps.fly_through(
        model, vrcaps.FlyThrough(whole=True), frames=FRAMES, fps=3.0, rng=rng
    )
    renderer = vrcaps.Renderer(
        model, vrcaps.RenderSettings(supersampling=3, shadows=True, light="radiosity")
    )
    frames = [renderer.render(flight.state(index), camera, channels=CHANNELS) for index in SHOWN]
    gap = ((GAP_PX, GAP_PX), (GAP_PX, GAP_PX), (0, 0))
    rows = [
        np.concatenate([np.pad(colors(frame, channel), gap) for frame in frames], axis=1)
        for channel in CHANNELS
    ]
    picture = Image.fromarray(np.concatenate(rows))
    picture = picture.resize((picture.width // 2, picture.height // 2), Image.Resampling.LANCZOS)
    picture.save(path, quality=90)


if __name__ == "__main__":
    main(Path(__file__).with_suffix(".jpg"))
