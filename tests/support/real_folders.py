"""Small folders of images in the layouts of published data sets."""

from pathlib import Path

import numpy as np
from PIL import Image

from tests.support.small_frames import image_of


def scene(seed: int, side: int = 96) -> np.ndarray:
    """A smooth image that resembles no other."""
    values = np.random.default_rng(seed).integers(30, 255, (6, 6, 3), np.uint8)
    return np.asarray(Image.fromarray(values).resize((side, side), Image.Resampling.BICUBIC))


def write_real(folder: Path, count: int = 16) -> Path:
    """Small folders in the layouts of Kvasir-SEG and HyperKvasir."""
    for number in range(count):
        image = scene(number, 48).copy()
        disk = image_of("instance", 2 * number + 1) > 0
        image[disk] = [220, 30, 30]
        kind = ("polyp", "ulcerative-colitis-grade-2", "other")[number % 3]
        for part, pixels in (
            ("kvasir_seg/images", image),
            ("kvasir_seg/masks", np.where(disk, 255, 0).astype(np.uint8)),
            (f"hyperkvasir/train/{kind}", scene(number + 50, 48)),
        ):
            (folder / part).mkdir(parents=True, exist_ok=True)
            Image.fromarray(pixels).save(folder / part / f"{number}.png")
    return folder
