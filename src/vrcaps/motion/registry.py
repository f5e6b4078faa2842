"""Registry of all motions for scenarios."""

from vrcaps.motion.dynamics import Dynamics
from vrcaps.motion.fly_through import FlyThrough
from vrcaps.motion.random_views import RandomViews
from vrcaps.motion.replay import Replay

AnyMotion = FlyThrough | RandomViews | Replay | Dynamics
