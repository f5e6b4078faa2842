"""Formats: external file layouts, written from episodes and data sets, read as frame sequences.

`format` lists them by field, `io` writes and reads any of them, `rectify` resamples to a pinhole.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
