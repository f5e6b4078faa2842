"""Draw the picture of the front page: recorded views of three organs, channel by channel.

python -m docs.images.channels
"""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image

import vrcaps
from docs.images.views import recorded
from vrcaps.scenario.scenario import parse_lesion

CHANNELS = ("rgb", "depth", "normal", "instance")
VIEWS = {"small-bowel": (0, 2), "stomach": (1, 5), "colon": (1, 5)}
"""Views of each organ that are shown, of six at random."""
LESIONS = {
    "small-bowel": ("bleeding-2", "angioectasia"),
    "stomach": ("ulcer-deep", "polyp-Is"),
    "colon": ("polyp-Ip:size=12mm", "bleeding-2"),
}
TILE_PX, GAP_PX = 160, 6


def colors(arrays: dict[str, np.ndarray], channel: str) -> np.ndarray:
    """A channel as an sRGB image, black where the lens sees nothing."""
    array, seen = arrays[channel], np.isfinite(arrays["depth"])
    if channel == "rgb":
        return array
    if channel == "depth":
        near = np.clip(1.0 - array / np.nanquantile(array, 0.99), 0.0, 1.0)
        image = matplotlib.colormaps["magma"](np.nan_to_num(near))[..., :3]
    elif channel == "normal":
        image = 0.5 - 0.5 * np.nan_to_num(array)
    else:
        image = matplotlib.colormaps["tab10"](array)[..., :3] * (array > 0)[..., None] + 0.15
    return (255.0 * np.clip(image, 0.0, 1.0) * seen[..., None] + 0.5).astype(np.uint8)


def views(organ: str) -> list[dict[str, np.ndarray]]:
    """Arrays of recorded frames with the default camera, contents and variation."""
    scenario = vrcaps.Scenario(
        organ=vrcaps.OrganGenerated(organ, seed=4),
        seed=4,
        capsule="mirocam",
        frames=6,
        motion=vrcaps.RandomViews(lesion_fraction=0.5),
        lesions=tuple(parse_lesion(text) for text in LESIONS[organ]),
        channels=CHANNELS,
    )
    frames = recorded(scenario)
    return [frames[index] for index in VIEWS[organ]]


def tile(arrays: dict[str, np.ndarray], channel: str) -> np.ndarray:
    """A channel at the size of the picture, with its gap."""
    nearest, smooth = Image.Resampling.NEAREST, Image.Resampling.LANCZOS
    image = Image.fromarray(colors(arrays, channel))
    image = image.resize((TILE_PX, TILE_PX), nearest if channel == "instance" else smooth)
    return np.pad(np.asarray(image), ((GAP_PX // 2,) * 2, (GAP_PX // 2,) * 2, (0, 0)))


def main(path: Path) -> None:
    """Record the views and write the picture."""
    shown = [arrays for organ in VIEWS for arrays in views(organ)]
    rows = [np.hstack([tile(arrays, channel) for arrays in shown]) for channel in CHANNELS]
    Image.fromarray(np.vstack(rows)).save(path, quality=90)


if __name__ == "__main__":
    main(Path(__file__).with_suffix(".jpg"))
