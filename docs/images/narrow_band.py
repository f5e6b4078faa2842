"""Draw the picture of narrow-band imaging: four places of a generated colon in both lights.

python docs/images/narrow_band.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

import vrcaps

SHOWN = (3, 9, 14, 17)  # of 20 frames along the whole colon


def main(path: Path) -> None:
    """White light above, narrow bands below."""
    model = vrcaps.Model(vrcaps.load_organ("colon", seed=0), vrcaps.load_device("mirocam"))
    rng = np.random.default_rng(0)
    flight = vrcaps.fly_through(model, vrcaps.FlyThrough(), frames=20, fps=3.0, rng=rng)
    rows = []
    for imaging in ("white-light", "narrow-band"):
        settings = vrcaps.RenderSettings(
            supersampling=2, shadows=True, light="quick", imaging=imaging
        )
        renderer, camera = vrcaps.Renderer(model, settings), model.device.cameras[0]
        images = [renderer.render(flight.state(k), camera, channels=("rgb",)).rgb for k in SHOWN]
        rows.append(np.hstack([np.asarray(image) for image in images]))
    Image.fromarray(np.vstack(rows)).resize((1000, 500), Image.Resampling.LANCZOS).save(
        path, quality=88
    )


if __name__ == "__main__":
    main(Path(__file__).with_suffix(".jpg"))
