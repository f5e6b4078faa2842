"""Output files of stitching: a figure of each step, and a table of the image pairs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.files import write_csv
from vrcaps.core.units import MM
from vrcaps.recording.frame_files import write_images
from vrcaps.render.channels import CHANNELS
from vrcaps.tools.reconstruction.matching import Pair, highlights, opencv, without_highlights
from vrcaps.tools.reconstruction.stitching.stitch import Stitched
from vrcaps.tools.reconstruction.stitching.surface import WallSurface

if TYPE_CHECKING:
    from jaxtyping import UInt8

_MARK = np.array([40, 255, 80], np.uint8)
_LINES = 60


def write_stitched(folder: Path, found: Stitched) -> None:
    """Write `highlights.png`, `matches.png`, `matches.csv`, `mosaic.png` and `depth.png`.

    Raises:
        MissingExtraError: If OpenCV is not installed.
    """
    images = {
        "highlights.png": highlights_picture(found.sequence.image("rgb", found.mosaic.reference)),
        "matches.png": matches_picture(found),
        "mosaic.png": found.mosaic.rgb,
        "depth.png": CHANNELS["depth"].encoding.encode(found.mosaic.depth),
    }
    write_images([(folder / name, image) for name, image in images.items()])
    used = set(found.mosaic.images)
    rows = [
        {
            "first_frame": int(found.frames[pair.first]),
            "second_frame": int(found.frames[pair.second]),
            "matches": pair.num_matches,
            "inliers": len(pair.points_first),
            "is_stitched": {pair.first, pair.second} <= used,
        }
        for pair in found.pairs
    ]
    write_csv(folder / "matches.csv", rows)


def write_registration(folder: Path, surface: WallSurface) -> None:
    """Write `registration.csv`, the error at each step, if there was a registration."""
    if surface.registration is not None:
        errors = enumerate(surface.registration.rmse)
        rows = [{"step": k, "rmse_mm": round(error / MM, 6)} for k, error in errors]
        write_csv(folder / "registration.csv", rows)


def highlights_picture(rgb: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h k 3"]:
    """Draw an image, its marked highlights, and the inpainted image."""
    marked = np.where(highlights(rgb)[..., None], _MARK, rgb)
    return np.concatenate([rgb, marked, without_highlights(rgb)], axis=1)


def matches_picture(found: Stitched) -> UInt8[np.ndarray, "h k 3"]:
    """Draw the pair of images with the most inliers, connected by lines."""
    cv2 = opencv()
    pair: Pair = max(found.pairs, key=lambda one: len(one.points_first))
    images = [found.sequence.image("rgb", k) for k in (pair.first, pair.second)]
    picture = np.concatenate(images, axis=1)
    shift = (images[0].shape[1], 0.0)
    chosen = np.unique(np.linspace(0, len(pair.points_first) - 1, _LINES).astype(int))
    for one, other in zip(pair.points_first[chosen], pair.points_second[chosen], strict=True):
        ends = [tuple(np.rint(p).astype(int).tolist()) for p in (one, other + shift)]
        cv2.line(picture, ends[0], ends[1], _MARK.tolist(), 1, cv2.LINE_AA)
    return picture
