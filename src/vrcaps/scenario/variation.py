"""Variation by prevalence: values that a scenario leaves open, drawn for each patient or recording.

No registry states how often a capsule sees fluid, bubbles or debris. The prevalences are estimates
from sheets of some 300 real small-bowel frames; each is an attribute of `Prevalence`, and
`PREVALENCES` holds those of all organs.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from vrcaps.core.rng import stream
from vrcaps.core.units import MM
from vrcaps.lumen.contents import CM2, Bubbles, Chyme, Contents, Film, Medium
from vrcaps.lumen.preparation import PREPARATIONS
from vrcaps.motion.dynamics_settings import DynamicsSettings
from vrcaps.motion.fly_through import FlyThrough
from vrcaps.organ.segments import Distension
from vrcaps.scenario.scenario import OrganGenerated, Scenario

_MOVING = ("bubbles", "chyme", "liquid")
_KINDS = (*_MOVING, "medium", "film")


@dataclass(frozen=True)
class Prevalence:
    """Prevalences of one organ.

    Attributes:
        distensions: Probability of each distension; None stands for the organ's own.
        tilt: Range of a fly-through's maximum tilt [rad].
        bubbles: Mean fraction of the gut's length with bubbles.
        chyme: Mean fraction of the gut's length with chyme.
        liquid: Probability of each severity of liquid in pools, from 0 on.
        preparations: Probability of each score of bowel preparation, from 3 down, which sets
            bubbles, chyme and liquid; empty for the three attributes above.
        medium: Mean fraction of the gut's length with turbid fluid.
        stain: Median absorption of clear fluid, relative to `STAIN`.
        film: Mean fraction of the gut's length with a film on the dome.
    """

    distensions: Mapping[Distension | None, float]
    tilt: tuple[float, float]
    bubbles: float = 0.0
    chyme: float = 0.0
    liquid: tuple[float, ...] = (1.0,)
    preparations: tuple[float, ...] = ()
    medium: float = 0.0
    stain: float = 0.0
    film: float = 0.0


STAIN = (2.0, 3.3, 22.0)
"""Median absorption of clear fluid in the small bowel for red, green and blue [1/m]: chosen so that
blue falls from bright to dark parts of a frame as in real frames."""

_Color = tuple[float, float, float]

BILE, RESIDUE, FLECKS = (0.4, 0.34, 0.08), (0.22, 0.12, 0.04), (0.5, 0.45, 0.36)
"""Linear colors of debris, by eye: stained by bile, brown, and white."""

_TURBIDITY = (0.8, 0.72, 0.56)
"""Median scattering coefficients of turbid fluid, relative to those of `Medium`. In a narrow lumen
much of the light that fluid scatters was reflected by the wall before; it is tinted by the
coefficients, because `Medium` is lit by the LEDs alone."""

PREVALENCES: Mapping[str, Prevalence] = MappingProxyType(
    {
        "small-bowel": Prevalence(
            {None: 0.92, "normal": 0.08},
            (1.0, 1.3),
            bubbles=0.3,
            chyme=0.08,
            medium=0.35,
            stain=1.0,
            film=0.4,
        ),
        "colon": Prevalence({None: 1.0}, (0.1, 0.35), bubbles=0.25, medium=0.15, film=0.3),
        "stomach": Prevalence({None: 1.0}, (0.1, 0.35), bubbles=0.3, medium=0.15, film=0.3),
        "full-tract": Prevalence(
            {None: 1.0}, (0.1, 0.35), bubbles=0.3, medium=0.25, stain=0.5, film=0.4
        ),
    }
)
"""Prevalences by generated organ. All are assumed; those of the small bowel follow estimates from
real frames: turbid fluid in a third, an open round lumen in fewer than one in ten, and a third to
a half of the frames soft. Bubbles are drawn everywhere; a third of real frames of the small bowel
have them, and every tenth debris. Chyme elsewhere and pools are absent, since there is no evidence
that they make images more realistic."""


def varied(scenario: Scenario) -> Scenario:
    """Return the scenario with its open settings drawn by prevalence.

    Settings that are given stay. Without `Scenario.variation`, or for an organ from a file,
    open contents are empty and other open settings stay open. Distension and contents
    depend on the seeds of the patient, `organ.seed` and `contents.seed`; the tilt on that of the
    recording. Quasi-static motion gets no bubbles, chyme or liquid, which move with inertia.
    """
    organ, contents, motion = scenario.organ, scenario.contents, scenario.motion
    prevalence = PREVALENCES.get(organ.name) if isinstance(organ, OrganGenerated) else None
    if prevalence is None or not scenario.variation:
        empty = {kind: 0 for kind in _KINDS if getattr(contents, kind) is None}
        return replace(scenario, contents=replace(contents, **empty))
    assert isinstance(organ, OrganGenerated)
    if organ.distension is None:
        rng = stream(organ.seed, "variation/distension")
        kinds, weights = list(prevalence.distensions), list(prevalence.distensions.values())
        organ = replace(organ, distension=kinds[int(rng.choice(len(kinds), p=weights))])
    if isinstance(motion, FlyThrough) and motion.tilt is None:
        tilt = stream(scenario.seed, "variation/tilt").uniform(*prevalence.tilt)
        motion = replace(motion, tilt=round(float(tilt), 3))
    drawn = drawn_contents(contents, prevalence)
    if isinstance(motion, DynamicsSettings) and motion.dynamics == "quasi-static":
        moving = {kind: 0 for kind in _MOVING if getattr(contents, kind) is None}
        drawn = replace(drawn, **moving)
    return replace(scenario, organ=organ, motion=motion, contents=drawn)


def drawn_contents(contents: Contents, prevalence: Prevalence) -> Contents:
    """Return the contents with each kind that is open drawn by its prevalence.

    Args:
        contents: Contents whose open kinds are None.
        prevalence: Prevalences of the organ.
    """
    seed = contents.seed
    drawn: dict[str, Any] = {
        "bubbles": _bubbles(prevalence.bubbles, stream(seed, "variation/bubbles")),
        "chyme": _chyme(prevalence.chyme, stream(seed, "variation/chyme")),
        "liquid": _severity(prevalence.liquid, seed, "liquid"),
        "medium": _medium(prevalence, stream(seed, "variation/medium")),
        "film": _film(prevalence.film, stream(seed, "variation/film")),
    }
    if prevalence.preparations:
        score = (
            len(prevalence.preparations)
            - 1
            - _severity(prevalence.preparations, seed, "preparation")
        )
        prepared = PREPARATIONS[score]
        drawn |= {kind: getattr(prepared, kind) for kind in _MOVING}
    return replace(
        contents, **{kind: drawn[kind] for kind in _KINDS if getattr(contents, kind) is None}
    )


def _severity(probabilities: tuple[float, ...], seed: int, name: str) -> int:
    rng = stream(seed, f"variation/{name}")
    return int(rng.choice(len(probabilities), p=probabilities))


def _fraction(mean: float, rng: np.random.Generator) -> float:
    """Fraction of the gut's length in one patient, for its mean over patients."""
    return round(min(float(rng.uniform(0.4, 1.6)) * mean, 1.0), 4)


def _bubbles(mean: float, rng: np.random.Generator) -> Bubbles | int:
    """Bubbles of one patient: single ones up to foam, where there are any."""
    prevalence, foam = _fraction(mean, rng), float(rng.uniform())
    per_area = 25.0 * 6.0**foam  # 25 to 150 per cm²
    raft = 8.0 * 10.0**foam
    radius = 0.36 * MM * 0.5**foam
    if prevalence == 0.0:
        return 0
    return Bubbles(
        per_area=round(per_area / CM2, 1),
        prevalence=prevalence,
        raft_size=round(raft, 2),
        radius=round(radius, 7),
    )


def _chyme(mean: float, rng: np.random.Generator) -> Chyme | int:
    """Debris of one patient, where there is any: white flecks and residue, from bile to brown."""
    prevalence, amount = _fraction(mean, rng), float(rng.uniform())
    white, brown = float(rng.uniform(0.2, 0.9)), float(rng.uniform())
    if prevalence == 0.0:
        return 0
    return Chyme(
        per_area=round(6.0 * 7.0**amount / CM2, 1),
        prevalence=prevalence,
        clump_size=round(4.0 * 5.0**amount, 2),
        radius=round(0.07 * MM * 1.8**amount, 7),
        smallest=0.03 * MM,
        white=round(white, 3),
        yellow_color=_between(brown, BILE, RESIDUE),
        white_color=FLECKS,
    )


def _between(part: float, first: _Color, second: _Color) -> _Color:
    """Geometric mean of two colors, with the weight `part` for the second."""
    red, green, blue = (
        round(a ** (1.0 - part) * b**part, 4) for a, b in zip(first, second, strict=True)
    )
    return red, green, blue


def _medium(of: Prevalence, rng: np.random.Generator) -> Medium | int:
    """Fluid of one patient: its stain, and prevalence, turbidity and bile of turbid fluid."""
    prevalence = _fraction(of.medium, rng)
    turbidity = math.exp(float(rng.normal(0.0, 0.3)))
    bile = math.exp(float(rng.normal(0.0, 0.4)))
    flocs = float(rng.uniform(0.0, 500.0))
    stain = of.stain * math.exp(float(rng.normal(0.0, 0.6)))
    if prevalence == stain == 0.0:
        return 0
    return Medium(
        prevalence=prevalence,
        absorption=_scaled(bile, Medium().absorption),
        scattering=_scaled(turbidity * Medium().scattering[0], _TURBIDITY),
        stain=_scaled(stain, STAIN),
        spread=0.6,
        floc_extinction=round(flocs, 2),
    )


def _scaled(factor: float, color: _Color) -> _Color:
    red, green, blue = (round(factor * x, 3) for x in color)
    return red, green, blue


def _film(mean: float, rng: np.random.Generator) -> Film | int:
    """Film on the dome in one recording: how often it occurs, and its thickness."""
    prevalence = _fraction(mean, rng)
    thickness = Film().thickness * math.exp(float(rng.normal(0.0, 0.3)))
    if prevalence == 0.0:
        return 0
    return Film(prevalence=prevalence, thickness=round(thickness, 7), spread=0.5)
