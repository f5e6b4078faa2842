"""First labeled frame: a colon, a capsule in it, and all channels of its camera.

    python examples/01_first_frame.py

Writes `first_frame.png` (color, depth, normals, gut segments side by side) and
`first_frame.npz` (the arrays themselves, SI units, NaN where the lens sees nothing).
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image

import vrcaps

CHANNELS = ("rgb", "depth", "normal", "label")


def main(out: Path, seed: int) -> None:
    """Render one frame and save it as arrays and as an image."""
    # An organ is a surface in the patient frame, with its mucosa as textures. Each seed is another
    # patient; the first generation takes some seconds, later ones are read from a cache.
    organ = vrcaps.generate_organ("colon", seed=seed)

    # Organ and capsule form a model: the constant part. A trajectory gives the capsule's pose.
    model = vrcaps.Model(organ, vrcaps.read_device("mirocam"))
    rng = np.random.default_rng(seed)
    flight = vrcaps.fly_through(model, vrcaps.FlyThrough(whole=True), frames=100, fps=3.0, rng=rng)

    # A renderer computes light and labels of a state of the world; a camera pipeline exposes the
    # light as the capsule does.
    camera = vrcaps.CameraPipeline(vrcaps.Renderer(model), "front", channels=CHANNELS)
    frame = camera.capture(vrcaps.Step(60, flight.state(60)))

    near, far = 1e3 * np.nanquantile(frame.depth, (0.01, 0.99))
    seen = [organ.label_names[label] for label in np.unique(frame.label) if label > 0]
    print(f"The wall is {near:.0f} to {far:.0f} mm away; in view: {', '.join(seen)}.")

    out.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(out / "first_frame.npz", **{c: getattr(frame, c) for c in CHANNELS})
    panels = [
        frame.rgb / 255.0,
        matplotlib.colormaps["viridis_r"](frame.depth / np.nanmax(frame.depth))[..., :3],
        np.nan_to_num(0.5 - 0.5 * frame.normal),
        matplotlib.colormaps["tab10"](frame.label)[..., :3] * (frame.label > 0)[..., None],
    ]
    picture = np.uint8(255.0 * np.nan_to_num(np.concatenate(panels, axis=1)) + 0.5)
    Image.fromarray(picture).save(out / "first_frame.png")
    print(f"Look at {out / 'first_frame.png'}.")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("runs/first-frame"))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--smoke", action="store_true", help="no shorter: it is one frame")
    args = parser.parse_args()
    main(args.out, args.seed)
