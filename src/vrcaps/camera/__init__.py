"""Cameras: lens, image, pose in the capsule and LEDs, and the rays of their pixels.

`camera` has the data type and the rays of its pixels, `lens` the lens models and their conversion,
`derive` changes a camera's size or distortion.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
