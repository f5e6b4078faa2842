"""Reconstruction of a wall from images with depth and poses, and its evaluation.

`fusion` fuses depth images into a surface, with poses that are given or estimated by odometry.
`stitching` combines the images into one and converts it to a surface. `estimates` reads estimated
depth and poses, `compare` measures a surface against the true wall and draws its errors.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
