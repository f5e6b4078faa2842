"""Environments to train and evaluate controllers: Gymnasium, Stable-Baselines3 and PettingZoo.

``import vrcaps.env`` registers them with Gymnasium; ``gymnasium.make("vrcaps.env:Coverage-v0")``
does both. Keyword arguments of `make` are fields of `EnvSettings`; a part is given by its name or
its settings, as in ``actuation="magnet"`` or ``actuation=MagnetActuation(speed=0.05)``.
"""

from vrcaps.core.errors import MissingExtraError

try:
    import gymnasium
except ImportError as error:
    raise MissingExtraError("gymnasium", "env") from error

from typing import Any as _Any

from vrcaps.env.actuation.actuation import Actuation as Actuation
from vrcaps.env.actuation.arm import ArmActuation as ArmActuation
from vrcaps.env.actuation.magnet import MagnetActuation as MagnetActuation
from vrcaps.env.actuation.registry import ACTUATIONS as ACTUATIONS
from vrcaps.env.actuation.wrench import Wrench as Wrench
from vrcaps.env.env import CapsuleEnv as CapsuleEnv
from vrcaps.env.observations.coverage_map import MapObservation as MapObservation
from vrcaps.env.observations.image import ImageObservation as ImageObservation
from vrcaps.env.observations.landmarks import LandmarksObservation as LandmarksObservation
from vrcaps.env.observations.observation import Observation as Observation
from vrcaps.env.observations.registry import OBSERVATIONS as OBSERVATIONS
from vrcaps.env.observations.state import StateObservation as StateObservation
from vrcaps.env.randomization import Randomization as Randomization
from vrcaps.env.registration import register as _register
from vrcaps.env.rewards import REWARDS as REWARDS
from vrcaps.env.rewards import Reward as Reward
from vrcaps.env.settings import EnvSettings as EnvSettings
from vrcaps.env.settings import env_settings as env_settings
from vrcaps.env.snapshot import EnvSnapshot as EnvSnapshot
from vrcaps.env.snapshot import read_env_snapshot as read_env_snapshot
from vrcaps.env.snapshot import write_env_snapshot as write_env_snapshot
from vrcaps.env.start import Start as Start
from vrcaps.env.tasks.coverage import CoverageTask as CoverageTask
from vrcaps.env.tasks.inspect import InspectTask as InspectTask
from vrcaps.env.tasks.navigate import NavigateTask as NavigateTask
from vrcaps.env.tasks.registry import TASKS as TASKS
from vrcaps.env.tasks.task import Task as Task
from vrcaps.env.vector_env import CapsuleVectorEnv as CapsuleVectorEnv
from vrcaps.lesion import Polyp as Polyp
from vrcaps.tissue.contact_laws import Drag as Drag
from vrcaps.tissue.tissue import Tissue as Tissue

_register(gymnasium)

_OPTIONAL = {"Sb3VecEnv": "vrcaps.env.sb3", "CapsuleParallelEnv": "vrcaps.env.parallel_env"}
"""Classes that need Stable-Baselines3 or PettingZoo, imported on first use."""


def __getattr__(name: str) -> _Any:
    """Import a class that needs an optional package.

    Raises:
        AttributeError: If there is no such name.
    """
    if name not in _OPTIONAL:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(_OPTIONAL[name]), name)
