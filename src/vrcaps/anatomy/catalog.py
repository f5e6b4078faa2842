"""Catalog of generated organs: each declared organ has a generator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from typing import TYPE_CHECKING

from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.fields import plain_value
from vrcaps.core.rng import MAX_SEED
from vrcaps.organ.cache import cached_organ, fingerprint
from vrcaps.organ.segments import DISTENSIONS, ORGANS
from vrcaps.organ.surface import OrganSurface

if TYPE_CHECKING:
    from vrcaps.anatomy.full_tract.patient import PatientAnatomy
    from vrcaps.mucosa.mucosa import Mucosa

    Generator = Callable[[PatientAnatomy], OrganSurface]

_GENERATORS: dict[str, Generator] = {}


def organ_generator(name: str) -> Callable[[Generator], Generator]:
    """Register a function as the generator of an organ.

    The function takes a patient and returns the organ's surface, without appearance unless its
    mucosa is not that of its first segment. The catalog bakes the appearance and caches the organ.
    The generators of built-in organs are in the folders of `vrcaps.anatomy` with the organs' names.

    Args:
        name: Name of the organ, one of `vrcaps.organ.segments.ORGANS`.
    """

    def declare(generator: Generator) -> Generator:
        _GENERATORS[name] = generator
        return generator

    return declare


def generate_organ(
    name: str,
    *,
    seed: int,
    distension: str | None = None,
    mucosa: str | Mucosa | None = None,
) -> OrganSurface:
    """Generate an organ with its appearance; each seed is a different patient.

    The result is stored in the user's cache folder (see `cache_folder`) and read from there
    afterwards. Organs of the same seed belong together, as the stomach and the colon of seed 3.

    Args:
        name: One of `ORGANS`.
        seed: Seed of the patient, 0 to 2**64 - 1.
        distension: `inflated`, `normal` or `collapsed`; None is the default: inflated for the
            colon, collapsed for the small bowel, normal for all others.
        mucosa: Appearance of the wall, see `bake_appearance`; None is the organ's default.

    Raises:
        UnknownNameError: If the catalog has no such organ or mucosa.
        InputError: If the seed is out of range or no whole number, or there is no such
            distension or texture.
    """
    if name not in ORGANS:
        raise UnknownNameError("organ", name, ORGANS)
    seed = plain_value(seed)
    if not (isinstance(seed, int) and 0 <= seed <= MAX_SEED):
        raise InputError(f"Seed is {seed!r}. Allowed: 0 to {MAX_SEED}.")
    if distension not in (None, *DISTENSIONS):
        raise InputError(f"Distension is {distension!r}. Allowed: {', '.join(DISTENSIONS)}.")
    if mucosa is not None:
        return _with_mucosa(name, seed, distension, mucosa)

    def make() -> OrganSurface:
        from vrcaps.anatomy.full_tract.patient import draw_patient_anatomy
        from vrcaps.mucosa.bake import bake_appearance

        organ = _generator(name)(draw_patient_anatomy(seed, distension))
        if organ.appearance is not None:
            return organ
        appearance = bake_appearance(organ, seed=seed, mucosa=ORGANS[name].mucosa)
        return replace(organ, appearance=appearance)

    return cached_organ(f"{name}-{seed}-{fingerprint({'distension': distension})}", make)


def _with_mucosa(
    name: str, seed: int, distension: str | None, mucosa: str | Mucosa
) -> OrganSurface:
    """Generated organ with a mucosa other than its default."""
    from vrcaps.mucosa.bake import bake_appearance
    from vrcaps.mucosa.mucosa import mucosa_fingerprint

    def make() -> OrganSurface:
        organ = generate_organ(name, seed=seed, distension=distension)
        return replace(organ, appearance=bake_appearance(organ, seed=seed, mucosa=mucosa))

    key = fingerprint({"distension": distension, **mucosa_fingerprint(mucosa)})
    return cached_organ(f"{name}-{seed}-mucosa-{key}", make)


def _generator(name: str) -> Generator:
    if name not in _GENERATORS:
        import_module(f"vrcaps.anatomy.{ORGANS[name].label}")
    return _GENERATORS[name]
