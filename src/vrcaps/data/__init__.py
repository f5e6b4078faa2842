"""Data sets: plan many recordings, make each exactly once, and read them back.

`plan` reads a plan, `units` resolves it to recordings, `make` records them in parallel into a
`store`, whose `ledger` lists the complete ones. `dataset` and `loading` read them back.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
