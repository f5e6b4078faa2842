"""Image files as other programs write them, by OpenCV."""

from pathlib import Path

import cv2
import numpy as np


def write_image(path: Path, image: np.ndarray, *options: int) -> None:
    """Write an image (red first) and its folder, in the format that the suffix names."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if image.ndim == 3:
        order = [2, 1, 0, 3][: image.shape[2]]
        image = np.ascontiguousarray(image[..., order])
    assert cv2.imwrite(str(path), image, list(options))
