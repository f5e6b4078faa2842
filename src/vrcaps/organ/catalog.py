"""The catalog of organs that need no file: each name has a generator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, replace

import numpy as np

from vrcaps.errors import InputError, UnknownNameError
from vrcaps.organ.cache import cached_organ, fingerprint
from vrcaps.organ.surface import OrganSurface


def load_organ(name: str, *, seed: int) -> OrganSurface:
    """A generated organ with its appearance, a different patient for each seed.

    It is made once and then read from the user's cache folder (see `cache_folder`).

    Args:
        name: One of `ORGANS`.
        seed: Of the patient; not negative.

    Raises:
        UnknownNameError: If the catalog has no such organ.
        InputError: If the seed is negative.
    """
    if name not in ORGANS:
        raise UnknownNameError("organ", name, ORGANS)
    if seed < 0:
        raise InputError(f"Seed {seed} is negative. Allowed: 0, 1, 2, …")
    return ORGANS[name](seed)


def _load_colon(seed: int) -> OrganSurface:
    """A patient drawn from the published distributions."""
    from vrcaps.organ.appearance import bake_appearance
    from vrcaps.organ.colon import ColonParameters, generate_colon

    parameters = ColonParameters.draw(np.random.default_rng([seed, 1]))

    def make() -> OrganSurface:
        organ = generate_colon(parameters, seed=seed)
        return replace(organ, appearance=bake_appearance(organ, seed=seed))

    return cached_organ(f"colon-{seed}-{fingerprint(asdict(parameters))}", make)


ORGANS: dict[str, Callable[[int], OrganSurface]] = {"colon": _load_colon}
"""Generators by name; each takes a seed."""
