"""Class of the image of a frame."""

import numpy as np

from vrcaps.lumen.particles import FIRST_CLUMP
from vrcaps.recording.frame_sequence import NORMAL, image_class, lesion_instances

LESIONS = [{"instance": 1, "kind": "polyp"}, {"instance": 2, "kind": "bleeding"}]


def frame(**pixels):
    """A hundred pixels, some of them of an instance."""
    numbers = np.zeros(100, np.uint16)
    at = 0
    for name, count in pixels.items():
        numbers[at : at + count] = {"polyp": 1, "bleeding": 2, "clump": FIRST_CLUMP + 7}[name]
        at += count
    return numbers.reshape(10, 10)


def test_the_largest_lesion_counts_if_it_is_large_enough():
    assert image_class(frame(), LESIONS, 0.05) == NORMAL
    assert image_class(frame(polyp=5, bleeding=9), LESIONS, 0.05) == "bleeding"
    assert image_class(frame(polyp=4), LESIONS, 0.05) is None


def test_clumps_of_chyme_are_no_lesions():
    assert image_class(frame(clump=40), LESIONS, 0.05) == NORMAL
    assert image_class(frame(clump=40, polyp=6), LESIONS, 0.05) == "polyp"
    shown = lesion_instances(frame(clump=40, bleeding=3))
    assert shown.dtype == np.uint16 and (shown == 2).sum() == 3 and (shown > 0).sum() == 3
