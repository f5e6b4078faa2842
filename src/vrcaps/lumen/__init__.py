"""Lumen contents: bubbles, chyme, liquid, turbid fluid and the film on the dome.

`contents` sets the contents by severity or parameters, `preparation` by the Boston scale.
`lumen_contents` holds the contents of an organ at one instant: `placement` positions the spheres
(`particles`), `along_gut` varies amounts along the gut, `pools` locates standing liquid.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
