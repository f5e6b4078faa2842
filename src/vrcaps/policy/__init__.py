"""Policies for the capsule in an environment, baselines and trained ones, and their evaluation.

`policy` defines the protocol of a policy; `catalog` lists the baselines and reads policies by name.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
