from arms import panda, six_joints, six_joints_text
from bent_tube import model, rng, tube

__all__ = ["model", "panda", "rng", "six_joints", "six_joints_text", "tube"]
