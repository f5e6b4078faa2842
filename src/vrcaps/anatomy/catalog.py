"""The catalog of organs that need no file: each name has a generator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, replace

from vrcaps.errors import InputError, UnknownNameError
from vrcaps.organ.cache import cached_organ, fingerprint
from vrcaps.organ.surface import OrganSurface

FULL_TRACT_COLON_TRIANGLES = 150_000
"""Of the colon in the joint tract, so that its edges are 2 mm long too."""


def generate_organ(
    name: str, *, seed: int, distension: str | None = None, mucosa: str | None = None
) -> OrganSurface:
    """A generated organ with its appearance, a different patient for each seed.

    It is made once and then read from the user's cache folder (see `cache_folder`). One seed is
    one patient: the stomach of seed 3 belongs to the colon of seed 3.

    Args:
        name: One of `ORGANS`.
        seed: Of the patient; not negative.
        distension: How full it is: `inflated`, `normal` or `collapsed`; None is the usual, the
            colon inflated, all else normal.
        mucosa: Look of the wall, see `bake_appearance`; None is the organ's own.

    Raises:
        UnknownNameError: If the catalog has no such organ, or there is no such mucosa.
        InputError: If the seed is negative, or there is no such distension or texture.
    """
    if name not in ORGANS:
        raise UnknownNameError("organ", name, ORGANS)
    if seed < 0:
        raise InputError(f"Seed {seed} is negative. Allowed: 0, 1, 2, …")
    if mucosa is None:
        return ORGANS[name](seed, distension)
    from vrcaps.mucosa.bake import bake_appearance
    from vrcaps.mucosa.mucosa import mucosa_fingerprint

    chosen = mucosa

    def make() -> OrganSurface:
        organ = ORGANS[name](seed, distension)
        return replace(organ, appearance=bake_appearance(organ, seed=seed, mucosa=chosen))

    key = fingerprint({"distension": distension, **mucosa_fingerprint(mucosa)})
    return cached_organ(f"{name}-{seed}-mucosa-{key}", make)


def _generate_colon(seed: int, distension: str | None) -> OrganSurface:
    from vrcaps.anatomy.colon import generate_colon
    from vrcaps.anatomy.full_tract.patient import draw_patient_anatomy
    from vrcaps.mucosa.bake import bake_appearance

    parameters = draw_patient_anatomy(seed, distension).colon

    def make() -> OrganSurface:
        organ = generate_colon(parameters, seed=seed)
        return replace(organ, appearance=bake_appearance(organ, seed=seed))

    return cached_organ(f"colon-{seed}-{fingerprint(asdict(parameters))}", make)


def _generate_stomach(seed: int, distension: str | None) -> OrganSurface:
    from vrcaps.anatomy.full_tract.patient import draw_patient_anatomy, stomach_axis
    from vrcaps.anatomy.stomach import generate_stomach
    from vrcaps.mucosa.bake import bake_appearance

    patient = draw_patient_anatomy(seed, distension)

    def make() -> OrganSurface:
        organ = generate_stomach(patient.stomach, seed=seed, course=stomach_axis(patient))
        return replace(organ, appearance=bake_appearance(organ, seed=seed, mucosa="stomach"))

    return cached_organ(f"stomach-{seed}-{fingerprint(asdict(patient))}", make)


def _generate_small_bowel(seed: int, distension: str | None) -> OrganSurface:
    from vrcaps.anatomy.full_tract.patient import draw_patient_anatomy, neighboring_organs
    from vrcaps.anatomy.small_bowel import generate_small_bowel
    from vrcaps.mucosa.bake import bake_appearance

    patient = draw_patient_anatomy(seed, distension)

    def make() -> OrganSurface:
        organ = generate_small_bowel(patient.small_bowel, neighboring_organs(patient), seed=seed)
        appearance = bake_appearance(organ, seed=seed, mucosa="small-bowel")
        return replace(organ, appearance=appearance)

    return cached_organ(f"small-bowel-{seed}-{fingerprint(asdict(patient))}", make)


def _generate_full_tract(seed: int, distension: str | None) -> OrganSurface:
    from vrcaps.anatomy.full_tract.appearance import with_appearance
    from vrcaps.anatomy.full_tract.generate import generate_full_tract
    from vrcaps.anatomy.full_tract.patient import draw_patient_anatomy

    patient = draw_patient_anatomy(seed, distension)

    def make() -> OrganSurface:
        colon = replace(patient.colon, triangles=FULL_TRACT_COLON_TRIANGLES)
        organ = generate_full_tract(patient.stomach, patient.small_bowel, colon, seed=seed)
        return with_appearance(organ, seed=seed)

    return cached_organ(f"gi-{seed}-{fingerprint(asdict(patient))}", make)


ORGANS: dict[str, Callable[[int, str | None], OrganSurface]] = {
    "colon": _generate_colon,
    "stomach": _generate_stomach,
    "small-bowel": _generate_small_bowel,
    "full-tract": _generate_full_tract,
}
"""Generators by name; each takes a seed and a distension."""

DISTENSIONS = ("inflated", "normal", "collapsed")
"""How full a generated organ can be."""


def organ_segments(name: str) -> tuple[str, ...]:
    """Names of the segments of a generated organ, from its oral end.

    Raises:
        UnknownNameError: If the catalog has no such organ.
    """
    from vrcaps.anatomy.colon.parameters import SEGMENTS as COLON
    from vrcaps.anatomy.small_bowel.parameters import SEGMENTS as SMALL_BOWEL
    from vrcaps.anatomy.stomach.parameters import SEGMENTS as STOMACH

    segments = {
        **{"colon": COLON, "stomach": STOMACH, "small-bowel": SMALL_BOWEL},
        "full-tract": (*STOMACH, *SMALL_BOWEL, *COLON),
    }
    if name not in segments:
        raise UnknownNameError("organ", name, segments)
    return segments[name]
