"""A camera and a cylinder whose coverage has a closed form."""

import math

import numpy as np

from tests.support.tubes import straight_tube
from vrcaps.camera.camera import Camera
from vrcaps.camera.lens import LensEquidistant

HALF_FIELD = math.radians(60.0)
POSE = np.eye(4)


def camera(size: int = 256) -> Camera:
    """A fisheye camera whose field is a circle of 120° that fits into the image."""
    center = (size - 1) / 2.0
    focal = 0.48 * size / HALF_FIELD
    lens = LensEquidistant(focal=focal, cx=center, cy=center, max_angle=HALF_FIELD)
    return Camera("front", lens, size, size, exposure=1.0)


def tube(radius: float = 0.02, length: float = 0.3, step: float = 4e-4) -> tuple:
    """Vertices and faces of an open cylinder along z from 0, fine along its axis."""
    organ = straight_tube(length, radius, 96, round(length / step) + 1)
    return organ.vertices, organ.faces
