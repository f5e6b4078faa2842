"""Types of the compiled core (Rust, `rust/src`)."""

import numpy as np
from numpy.typing import NDArray

__version__: str

class Wall:
    """A triangle surface with its bounding-volume hierarchy; normals point into the lumen."""

    def __init__(self, vertices: NDArray, faces: NDArray) -> None: ...
    def refit(self, vertices: NDArray) -> None: ...
    def cast(
        self, origins: NDArray, directions: NDArray
    ) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        """Distance (in units of the direction's length; NaN for none) and face (−1) per ray."""
    def signed_distance(self, points: NDArray) -> NDArray[np.float32]:
        """Distance to the wall [m], positive inside the lumen."""
    def closest_point(self, points: NDArray) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        """Nearest wall point [n 3] and its face."""

def bake_mucosa(
    wall: NDArray[np.float32],
    faces: NDArray[np.uint32],
    uv: NDArray[np.float64],
    layout: tuple[int, int, float],
    seed: int,
    mucosa: object,
) -> tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.float32]]:
    """Flat sRGB albedo, roughness and height [m] of a mucosa (`vrcaps.organ.appearance`)."""
