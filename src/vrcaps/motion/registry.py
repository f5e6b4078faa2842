"""All motions that a scenario may have."""

from vrcaps.motion.dynamics import Dynamics
from vrcaps.motion.fly_through import FlyThrough
from vrcaps.motion.replay import Replay

AnyMotion = FlyThrough | Replay | Dynamics
