"""Contents of the lumen at one instant."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from vrcaps._core import Wall, around_capsule
from vrcaps.core.geometry import transform_points, wall_of
from vrcaps.core.rng import stream
from vrcaps.core.units import MM
from vrcaps.lumen.contents import Contents
from vrcaps.lumen.particles import Spheres, joined
from vrcaps.lumen.placement import place_bubbles, place_chyme, place_dome_bubbles
from vrcaps.lumen.pools import Pools, cut_sections, find_pools
from vrcaps.organ.surface import OrganSurface

if TYPE_CHECKING:
    from jaxtyping import Float, Int

_LIFE = 20.0 * MM
"""Distance that the capsule travels before a bubble on its dome is replaced [m]."""

_WIDEST = np.deg2rad(45.0)
"""Maximum angle of a site from the capsule's axis."""
_TRIES = 12
"""Random positions tried for each bubble on the capsule."""

CHYME = "chyme"
"""Class name of the particles; its label follows those of the organ."""


@dataclass(frozen=True)
class LumenContents:
    """Bubbles, chyme and liquid in the world frame.

    Attributes:
        contents: Parameters of the contents.
        spheres: Bubbles and chyme.
        pools: Liquid, or None.
        dome_sites: Positions of the last spheres on the capsule, in its frame relative to its
            center [m]; their `centers` are where they reform after bursting.
    """

    contents: Contents
    spheres: Spheres
    pools: Pools | None = None
    dome_sites: Float[np.ndarray, "k 3"] = field(default_factory=lambda: np.zeros((0, 3)))

    def with_capsule(self, length: float, radius: float) -> LumenContents:
        """Add dome_sites on the round ends of a capsule.

        Args:
            length: Overall length of the capsule [m].
            radius: Radius of the capsule [m].
        """
        bubbles, _, _ = self.contents.resolved
        rng = stream(self.contents.seed, "lumen/dome-sites")
        own = self.spheres.radius[len(self.spheres) - 2 * bubbles.on_dome :]
        return replace(self, dome_sites=dome_sites(own, length, radius, rng))

    def on_dome(self, arc_length: float, length: float, radius: float) -> LumenContents:
        """Place the bubbles on the capsule as they are after traveling to an arc length.

        Each stays on the dome for a distance of travel and then reforms elsewhere on it, so that
        they are elsewhere in distant views.

        Args:
            arc_length: Position of the capsule along the centerline [m].
            length: Overall length of the capsule [m].
            radius: Radius of the capsule [m].
        """
        count = len(self.dome_sites)
        if count == 0:
            return self
        own, distance = self.spheres.radius[len(self.spheres) - count :], arc_length / _LIFE
        patches = np.floor(distance + np.arange(count) / count).astype(int)
        sites = np.empty((count, 3))
        for patch in np.unique(patches):
            rng = stream(self.contents.seed, "lumen/dome-sites", 1 + abs(int(patch)))
            sites[patches == patch] = dome_sites(own, length, radius, rng)[patches == patch]
        return replace(self, dome_sites=sites)

    def on_wall(
        self,
        anchors: tuple[Int[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]],
        vertices: Float[np.ndarray, "v 3"],
        at_rest: Float[np.ndarray, "v 3"],
    ) -> LumenContents:
        """Move the spheres with the wall that they cling to.

        Args:
            anchors: Result of `wall_anchors`.
            vertices: Vertices of the wall [m].
            at_rest: Vertices of the wall at rest, in the same frame [m].
        """
        corners, weights = anchors
        offset = vertices.take(corners, axis=0) - at_rest.take(corners, axis=0)
        moved = np.einsum("nk,nki->ni", weights, offset)
        return replace(self, spheres=self.spheres.at(self.spheres.centers + moved))

    def around_capsule(
        self, T_world_capsule: Float[np.ndarray, "4 4"], length: float, radius: float
    ) -> LumenContents:
        """Push aside contents in a capsule's way, and attach its bubbles.

        Args:
            T_world_capsule: Pose of the capsule, with its center as the origin.
            length: Overall length of the capsule [m].
            radius: Radius of the capsule [m].
        """
        spheres, capsule = self.spheres, (length / 2.0 - radius, radius)
        centers = around_capsule(
            spheres.centers, spheres.radius, self.dome_sites, T_world_capsule, capsule
        )
        if centers is None:
            return self
        return LumenContents(self.contents, spheres.at(centers), self.pools)


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
    positions = np.zeros((len(radius), 3))
    half = length / 2.0 - capsule_radius
    for k, own in enumerate(radius):
        cosine = rng.uniform(np.cos(_WIDEST), 1.0, _TRIES)
        sine, turn = np.sqrt(1.0 - cosine**2), rng.uniform(0.0, 2.0 * np.pi, _TRIES)
        normal = np.stack([sine * np.cos(turn), sine * np.sin(turn), cosine], axis=1)
        tried = (capsule_radius + own) * normal + np.array([0.0, 0.0, half])
        tried *= np.array([1.0, 1.0, -1.0 if k % 2 else 1.0])
        apart = np.linalg.norm(tried[:, None] - positions[:k], axis=-1) - radius[:k] - own
        positions[k] = tried[np.argmax(apart.min(axis=1, initial=np.inf))]
    return positions


def wall_anchors(
    spheres: Spheres, wall: Wall, vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]
) -> tuple[Int[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Vertices of the triangle nearest to each sphere, and their barycentric weights there.

    Args:
        spheres: Spheres in the frame of the wall.
        wall: Hierarchy of the wall.
        vertices: Its vertices [m].
        faces: Its triangles.
    """
    nearest, face = wall.closest_point(np.ascontiguousarray(spheres.centers, np.float64))
    corners = faces[face]
    a, b, c = (vertices[corners[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    area = np.maximum((normal**2).sum(axis=1), 1e-30)
    second = (np.cross(nearest - a, c - a) * normal).sum(axis=1) / area
    third = (np.cross(b - a, nearest - a) * normal).sum(axis=1) / area
    weights = np.clip(np.stack([1.0 - second - third, second, third], axis=1), 0.0, 1.0)
    return corners, weights / weights.sum(axis=1, keepdims=True)


def populate(
    organ: OrganSurface, contents: Contents, T_world_patient: Float[np.ndarray, "4 4"]
) -> LumenContents:
    """Fill an organ whose wall is at rest.

    Args:
        organ: The wall, in the patient frame.
        contents: Settings of the contents.
        T_world_patient: Posture of the patient; gravity is world −z.
    """
    bubbles, chyme, liquid = contents.resolved
    wall = wall_of(organ.vertices, organ.faces)
    up = T_world_patient[:3, :3].T @ np.array([0.0, 0.0, 1.0])
    seed = contents.seed
    clinging = place_bubbles(organ, wall, bubbles, up, stream(seed, "lumen/bubbles"))
    spheres = joined(
        clinging,
        place_chyme(organ, wall, chyme, up, stream(seed, "lumen/chyme")),
        place_dome_bubbles(
            organ, bubbles, stream(seed, "lumen/dome-bubbles"), before=len(clinging)
        ),
    )
    centers = transform_points(T_world_patient, spheres.centers)
    pools = None
    if liquid.fill > 0.0:
        pools = find_pools(organ, cut_sections(organ), liquid, T_world_patient)
    return LumenContents(contents, spheres.at(centers), pools)
