"""Lumen contents: bubbles, chyme and liquid.

`contents` sets the contents by severity, by parameters or by the Boston scale. `lumen_contents`
holds the contents of an organ at one instant: `placement` positions the spheres (`particles`),
`pools` locates standing liquid.
The names in `__init__.pyi` are loaded on first use.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
