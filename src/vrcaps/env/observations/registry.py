"""Registry of the observations of an environment."""

from vrcaps.config.convert import register_family
from vrcaps.core.registry import Registry
from vrcaps.env.observations.observation import Observation

_FOLDER = "vrcaps.env.observations"
OBSERVATIONS: Registry[Observation] = Registry(
    "observation",
    {
        "state": (f"{_FOLDER}.state:StateObservation", "pose, velocities and contact force"),
        "landmarks": (f"{_FOLDER}.landmarks:LandmarksObservation", "navigation features"),
        "map": (f"{_FOLDER}.coverage_map:MapObservation", "seen fraction in gut coordinates"),
        "image": (f"{_FOLDER}.image:ImageObservation", "channel of a camera"),
    },
)
"""Observations by name, including those of plug-ins."""

register_family(Observation, OBSERVATIONS)
