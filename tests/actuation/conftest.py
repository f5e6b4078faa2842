from tests.support.arms import panda, six_joints, six_joints_text
from tests.support.bent_tube import model, rng, tube

__all__ = ["model", "panda", "rng", "six_joints", "six_joints_text", "tube"]
