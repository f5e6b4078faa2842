"""Motions of the capsule: fly-through, random views, replay of a recorded path, and dynamics.

Each kind is one file (`fly_through`, `random_views`, `replay`, `dynamics`) and one line in
`registry`; `motion` defines their interface. A motion yields one `motion.Step` per frame, from a
`trajectory` known in advance or from a `rollout` of the world.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
