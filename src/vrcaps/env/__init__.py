"""Environments to train and evaluate controllers: Gymnasium, Stable-Baselines3 and PettingZoo.

``import vrcaps.env`` registers them with Gymnasium; ``gymnasium.make("vrcaps.env:Coverage-v0")``
does both. Keyword arguments of `make` are fields of `EnvSettings`; a part is given by its name or
its settings, as in ``actuation="magnet"`` or ``actuation=MagnetActuation(speed=0.05)``.
"""

from vrcaps.core.errors import MissingExtraError

try:
    import gymnasium  # noqa: F401
except ImportError as error:
    raise MissingExtraError("gymnasium", "env") from error

from typing import Any as _Any

from vrcaps.env.actuation import ArmActuation as ArmActuation
from vrcaps.env.actuation import MagnetActuation as MagnetActuation
from vrcaps.env.actuation import Wrench as Wrench
from vrcaps.env.env import CapsuleEnv as CapsuleEnv
from vrcaps.env.env import register as _register
from vrcaps.env.exploration import ExplorationObservation as ExplorationObservation
from vrcaps.env.landmarks import LandmarksObservation as LandmarksObservation
from vrcaps.env.observations import ImageObservation as ImageObservation
from vrcaps.env.observations import MapObservation as MapObservation
from vrcaps.env.observations import StateObservation as StateObservation
from vrcaps.env.parts import ACTUATIONS as ACTUATIONS
from vrcaps.env.parts import OBSERVATIONS as OBSERVATIONS
from vrcaps.env.parts import REWARDS as REWARDS
from vrcaps.env.parts import TASKS as TASKS
from vrcaps.env.parts import Actuation as Actuation
from vrcaps.env.parts import EnvView as EnvView
from vrcaps.env.parts import Observation as Observation
from vrcaps.env.parts import Reward as Reward
from vrcaps.env.parts import Task as Task
from vrcaps.env.randomization import Randomization as Randomization
from vrcaps.env.randomization import Start as Start
from vrcaps.env.rewards import AreaGain as AreaGain
from vrcaps.env.rewards import ForcePenalty as ForcePenalty
from vrcaps.env.rewards import LogGain as LogGain
from vrcaps.env.rewards import PaperGain as PaperGain
from vrcaps.env.rewards import ProgressGain as ProgressGain
from vrcaps.env.rewards import Success as Success
from vrcaps.env.rewards import ThresholdedGain as ThresholdedGain
from vrcaps.env.rewards import TimePenalty as TimePenalty
from vrcaps.env.rewards import TotalVariation as TotalVariation
from vrcaps.env.settings import EnvSettings as EnvSettings
from vrcaps.env.settings import env_settings as env_settings
from vrcaps.env.simulation import EnvSnapshot as EnvSnapshot
from vrcaps.env.simulation import read_env_snapshot as read_env_snapshot
from vrcaps.env.simulation import write_env_snapshot as write_env_snapshot
from vrcaps.env.tasks import CoverageTask as CoverageTask
from vrcaps.env.tasks import InspectTask as InspectTask
from vrcaps.env.tasks import NavigateTask as NavigateTask
from vrcaps.env.vector_env import CapsuleVectorEnv as CapsuleVectorEnv
from vrcaps.lesion import Polyp as Polyp
from vrcaps.tissue.tissue import Drag as Drag
from vrcaps.tissue.tissue import Tissue as Tissue

_register()

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
