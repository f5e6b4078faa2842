"""A seeded stomach: J shape, rugae that flatten as it fills, antral waves, pyloric ring."""

from vrcaps.anatomy.stomach.generate import generate_stomach as generate_stomach
from vrcaps.anatomy.stomach.parameters import StomachParameters as StomachParameters
