"""Independent random streams: one generator for each purpose, all from one seed.

A seed alone is no stream: two generators with the same seed draw the same numbers, and what they
decide is then correlated. Each purpose therefore has a name, and the name is part of the seed
(the `spawn_key` of NumPy's `SeedSequence`).
"""

from __future__ import annotations

import hashlib

import numpy as np


def stream(seed: int, purpose: str, *index: int) -> np.random.Generator:
    """Generator for one purpose, such as ``"colon/course"``, independent of all others.

    The same arguments give the same numbers on every machine.

    Args:
        seed: Of the patient, the scenario or whatever is drawn, 0 or more.
        purpose: Name of what is drawn; each place in the source has its own.
        index: Numbers that tell members of the purpose apart, such as a frame's, 0 or more.
    """
    digest = hashlib.sha256(purpose.encode()).digest()
    words = np.frombuffer(digest[:16], "<u4").tolist()
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(*words, *index)))
