"""Training on images: depth, segmentation, classification, super-resolution and motion.

A `Task` defines the samples, the network, the loss and the metrics of one task; `TASKS` lists them
and registers those of users. `train` trains any task, `read_weights` reads checkpoints, `evaluate`
and `predict` use them. The names in `__init__.pyi` are loaded when they are first used, since
PyTorch takes seconds to load.
"""

import lazy_loader

from vrcaps.core.errors import MissingExtraError

_load, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> object:
    """Import a public name from its module.

    Raises:
        AttributeError: If there is no such name.
        MissingExtraError: If PyTorch is not installed.
    """
    try:
        return _load(name)
    except ModuleNotFoundError as error:
        if error.name != "torch":
            raise
        raise MissingExtraError("torch", "learn") from error
