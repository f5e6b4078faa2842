"""Lumen contents: bubbles, chyme and liquid.

`contents.Contents` sets the contents by severity or by parameters, `bowel_preparation` by the
Boston scale. `lumen_contents` holds the contents of an organ at one instant: `placement` and
`cluster` position the spheres (`particles`), `pools` locates standing liquid.
The names in `__init__.pyi` are loaded on first use.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
