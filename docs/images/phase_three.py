"""Draw the video of the gallery: phase III carries a capsule through a collapsed jejunum.

The dome has no film, so that the wall is sharp in all frames.

python -m docs.images.phase_three
"""

from __future__ import annotations

from pathlib import Path

from PIL import Image

import vrcaps
from docs.images.views import recorded
from vrcaps.tissue.tissue import Drag

FRAMES, FPS, SIDE_PX = 120, 6.0, 256


def main(path: Path) -> None:
    """Record the transit and write its images as an animation."""
    scenario = vrcaps.Scenario(
        organ=vrcaps.OrganGenerated("small-bowel", seed=1),
        seed=1,
        capsule="mirocam",
        frames=FRAMES,
        fps=FPS,
        channels=("rgb",),
        contents=vrcaps.Contents(film=0),
        motion=vrcaps.Dynamics(
            start=0.24, motility="phase-three", drag=Drag(viscosity=1.0), substep=2e-4
        ),
    )
    frames = recorded(scenario)
    images = [Image.fromarray(frame["rgb"]).resize((SIDE_PX, SIDE_PX)) for frame in frames]
    images[0].save(
        path, save_all=True, append_images=images[1:], duration=round(1e3 / FPS), loop=0, quality=55
    )


if __name__ == "__main__":
    main(Path(__file__).with_suffix(".webp"))
