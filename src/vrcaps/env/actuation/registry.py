"""Registry of all actuations: the type of the setting."""

from typing import TypeAlias

from vrcaps.env.actuation.arm import ArmActuation
from vrcaps.env.actuation.magnet import MagnetActuation
from vrcaps.env.actuation.wrench import Wrench

AnyActuation: TypeAlias = Wrench | MagnetActuation | ArmActuation
