"""vrcaps: a virtual environment for capsule endoscopy.

The names in each `__init__.pyi` are imported on first use, so that imports of packages are cheap.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
