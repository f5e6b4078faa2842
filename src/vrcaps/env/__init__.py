"""Environments to train and judge controllers in: Gymnasium, Stable-Baselines3 and PettingZoo.

``import vrcaps.env`` registers them with Gymnasium; ``gymnasium.make("vrcaps.env:Coverage-v0")``
does both. Keywords of `make` are fields of `EnvSettings`; a part is its name or its settings, as in
``actuation="magnet"`` or ``actuation=Magnet(speed=0.05)``.
"""

from vrcaps.errors import MissingExtraError

try:
    import gymnasium
except ImportError as error:
    raise MissingExtraError("gymnasium", "env") from error

from vrcaps.env.env import CapsuleEnv as CapsuleEnv
from vrcaps.env.registration import register as _register
from vrcaps.env.settings import EnvSettings as EnvSettings
from vrcaps.env.vector_env import CapsuleVectorEnv as CapsuleVectorEnv

_register(gymnasium)
