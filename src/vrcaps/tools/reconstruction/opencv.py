"""Import of OpenCV."""

from __future__ import annotations

from typing import Any

from vrcaps.core.errors import import_extra


def opencv() -> Any:
    """Import OpenCV.

    Raises:
        MissingExtraError: If it is not installed.
    """
    return import_extra("cv2", "reconstruct", package="opencv-python-headless")
