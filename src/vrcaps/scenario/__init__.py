"""Scenarios: everything that defines a recording, as one tree of dataclasses.

`scenario.Scenario` is the tree, read from and written to TOML or JSON; `settings` changes it by
path (`--set`). `build` resolves its open settings and creates organ, model of the world and motion.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
