"""Bubbles attached to the round ends of a capsule."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vrcaps.lumen.bubbles import Bubbles
from vrcaps.lumen.particles import BUBBLE, Spheres
from vrcaps.lumen.placement import LIFT_BUBBLE, cut_log_normal
from vrcaps.organ.surface import OrganSurface

if TYPE_CHECKING:
    from jaxtyping import Float

_WIDEST = np.deg2rad(45.0)
"""Maximum angle of a site from the capsule's axis."""

_TRIES = 12


def place_dome_bubbles(
    organ: OrganSurface, bubbles: Bubbles, rng: np.random.Generator, *, before: int
) -> Spheres:
    """Create the bubbles for both ends of a capsule; when they burst, they reform on the wall.

    Args:
        organ: The wall at rest; the bubbles are in its frame.
        bubbles: Number and sizes.
        rng: Random generator.
        before: Number of preceding bubble instances.
    """
    count = 2 * bubbles.on_dome
    radius = cut_log_normal(bubbles, count, rng)
    vertex = rng.integers(0, len(organ.vertices), count)
    lift = (LIFT_BUBBLE * radius)[:, None] * organ.normals[vertex]
    return Spheres(
        centers=organ.vertices[vertex] + lift,
        radius=radius,
        kind=np.full(count, BUBBLE, np.uint8),
        instance=(1 + (before + np.arange(count)) % 65535).astype(np.uint16),
        color=np.tile(bubbles.color, (count, 1)),
        arc_length=organ.arc_length[vertex],
    )


def dome_sites(
    radius: Float[np.ndarray, " n"],
    length: float,
    capsule_radius: float,
    rng: np.random.Generator,
) -> Float[np.ndarray, "n 3"]:
    """Positions of bubbles that touch a capsule's round ends, alternating front and rear.

    Positions are uniform over each end; of a few tries, the one with the most clearance is taken.

    Args:
        radius: Radii of the bubbles [m].
        length: Overall length of the capsule [m].
        capsule_radius: Radius of the capsule [m].
        rng: Random generator.

    Returns:
        Positions in the capsule frame, relative to its center [m].
    """
    places = np.zeros((len(radius), 3))
    half = length / 2.0 - capsule_radius
    for k, own in enumerate(radius):
        cosine = rng.uniform(np.cos(_WIDEST), 1.0, _TRIES)
        sine, turn = np.sqrt(1.0 - cosine**2), rng.uniform(0.0, 2.0 * np.pi, _TRIES)
        normal = np.stack([sine * np.cos(turn), sine * np.sin(turn), cosine], axis=1)
        tried = (capsule_radius + own) * normal + np.array([0.0, 0.0, half])
        tried *= np.array([1.0, 1.0, -1.0 if k % 2 else 1.0])
        apart = np.linalg.norm(tried[:, None] - places[:k], axis=-1) - radius[:k] - own
        places[k] = tried[np.argmax(apart.min(axis=1, initial=np.inf))]
    return places
