"""Draw the picture of the wet film: one place of a generated colon from dry to flooded.

python -m docs.images.film
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

import vrcaps

THICKNESS_UM = (0.0, 2.0, 10.0, 60.0, 200.0)
SIDE_PX = 240


def main(path: Path) -> None:
    """Thicker from left to right; the whole view above, its middle below."""
    model = vrcaps.Model(vrcaps.generate_organ("colon", seed=0), vrcaps.read_device("mirocam"))
    rng = np.random.default_rng(0)
    flight = vrcaps.fly_through(model, vrcaps.FlyThrough(whole=True), frames=20, fps=3.0, rng=rng)
    camera, columns = model.device.cameras[0], []
    for film in THICKNESS_UM:
        settings = vrcaps.RenderSettings(
            supersampling=3, shadows=True, light="radiosity", mucus_film_um=film
        )
        frame = vrcaps.Renderer(model, settings).render(flight.state(9), camera, channels=("rgb",))
        image = Image.fromarray(np.asarray(frame.rgb))
        width, height = image.size
        middle = image.crop((width // 3, height // 3, 2 * width // 3, 2 * height // 3))
        column = np.vstack(
            [np.asarray(part.resize((SIDE_PX, SIDE_PX), Image.Resampling.LANCZOS))
             for part in (image, middle)]
        )  # fmt: skip
        labeled = Image.fromarray(column)
        ImageDraw.Draw(labeled).text((8, 6), f"{film:g} um", fill="white")
        columns.append(np.asarray(labeled))
    Image.fromarray(np.hstack(columns)).save(path, quality=88)


if __name__ == "__main__":
    main(Path(__file__).with_suffix(".jpg"))
