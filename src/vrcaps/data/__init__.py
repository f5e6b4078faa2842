"""Data sets: plans of many recordings, their units, making them exactly once, reading them.

`plan` reads a plan, `units` resolves it to recordings, `make` records them with many workers into
a `store`, whose `ledger` says which are whole. `dataset` and `sequences` read them back.

The names in `__init__.pyi` are loaded when they are first used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
