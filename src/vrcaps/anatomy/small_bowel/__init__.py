"""A seeded small bowel: the duodenum's C, jejunum and ileum coiled in the abdomen."""

from vrcaps.anatomy.small_bowel.generate import generate_small_bowel as generate_small_bowel
from vrcaps.anatomy.small_bowel.parameters import SmallBowelParameters as SmallBowelParameters
