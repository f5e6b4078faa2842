"""Registry of the actuations of an environment."""

from vrcaps.config.convert import register_family
from vrcaps.core.registry import Registry
from vrcaps.env.actuation.actuation import Actuation

_FOLDER = "vrcaps.env.actuation"
ACTUATIONS: Registry[Actuation] = Registry(
    "actuation",
    {
        "wrench": (f"{_FOLDER}.wrench:Wrench", "force and torque on the capsule"),
        "magnet": (f"{_FOLDER}.magnet:MagnetActuation", "external magnet that moves freely"),
        "arm": (f"{_FOLDER}.arm:ArmActuation", "external magnet on a robot arm"),
    },
)
"""Actuations by name, including those of plug-ins."""

register_family(Actuation, ACTUATIONS)
