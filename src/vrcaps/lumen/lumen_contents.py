"""Contents of the lumen at one instant."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from vrcaps._core import around_capsule
from vrcaps.core.geometry import wall_of
from vrcaps.core.rng import stream
from vrcaps.core.transforms import transform_points
from vrcaps.lumen.contents import Contents
from vrcaps.lumen.particles import Spheres, joined
from vrcaps.lumen.placement import dome_sites, place_bubbles, place_chyme, place_dome_bubbles
from vrcaps.lumen.pools import Pools, cut_sections, find_pools
from vrcaps.organ.surface import OrganSurface

if TYPE_CHECKING:
    from jaxtyping import Float

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
