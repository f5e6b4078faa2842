"""Camera pipeline: from scene radiance to the image that a capsule's camera transmits.

The effects of each stage are one module in `effect/`, with parameters for severities 0 to 4;
`effects.Effects` collects those of a recording and parses them from text.
`pipeline.CameraPipeline` applies them to one camera, `capsule_cameras` to all cameras of a capsule.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
