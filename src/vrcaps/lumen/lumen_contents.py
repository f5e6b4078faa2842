"""What is in the lumen at one instant."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

import vrcaps.rng
from vrcaps._core import around_capsule
from vrcaps.lumen.contents import Contents
from vrcaps.lumen.dome_attachment import dome_sites, place_dome_bubbles
from vrcaps.lumen.particles import Spheres, joined
from vrcaps.lumen.placement import place_bubbles, place_chyme
from vrcaps.lumen.pools import Pools, cut_sections, find_pools
from vrcaps.mesh.mesh import wall_of
from vrcaps.organ.surface import OrganSurface
from vrcaps.transforms import transform_points

if TYPE_CHECKING:
    from jaxtyping import Float

CHYME = "chyme"
"""Name of the class of particles; its number follows those of the organ."""


@dataclass(frozen=True)
class LumenContents:
    """Bubbles, chyme and liquid in the world frame.

    Attributes:
        contents: Their figures.
        spheres: Bubbles and chyme.
        pools: Liquid; None where there is none.
        dome_sites: Where the last of the spheres sit on the capsule, in its frame about its
            middle [m]; their centers are where others form when they burst.
    """

    contents: Contents
    spheres: Spheres
    pools: Pools | None = None
    dome_sites: Float[np.ndarray, "k 3"] = field(default_factory=lambda: np.zeros((0, 3)))

    def with_capsule(self, length: float, radius: float) -> LumenContents:
        """The contents with dome_sites on the round ends of a capsule.

        Args:
            length: Its overall length [m].
            radius: Its radius [m].
        """
        bubbles, _, _ = self.contents.resolved
        rng = vrcaps.rng.stream(self.contents.seed, "lumen/dome-sites")
        own = self.spheres.radius[len(self.spheres) - 2 * bubbles.on_dome :]
        return replace(self, dome_sites=dome_sites(own, length, radius, rng))

    def around_capsule(
        self, T_world_capsule: Float[np.ndarray, "4 4"], length: float, radius: float
    ) -> LumenContents:
        """The contents with what is in a capsule's way pushed aside, and what sits on it there.

        Args:
            T_world_capsule: Pose of the capsule, whose middle is taken as its origin.
            length: Its overall length [m].
            radius: Its radius [m].
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
    """Fills an organ whose wall is at rest.

    Args:
        organ: The wall, in the patient frame.
        contents: What is to be in it.
        T_world_patient: How the patient lies; gravity is world −z.
    """
    bubbles, chyme, liquid = contents.resolved
    wall = wall_of(organ.vertices, organ.faces)
    up = T_world_patient[:3, :3].T @ np.array([0.0, 0.0, 1.0])
    seed = contents.seed
    clinging = place_bubbles(organ, wall, bubbles, up, vrcaps.rng.stream(seed, "lumen/bubbles"))
    spheres = joined(
        clinging,
        place_chyme(organ, wall, chyme, up, vrcaps.rng.stream(seed, "lumen/chyme")),
        place_dome_bubbles(
            organ, bubbles, vrcaps.rng.stream(seed, "lumen/dome-bubbles"), before=len(clinging)
        ),
    )
    centers = transform_points(T_world_patient, spheres.centers)
    pools = None
    if liquid.fill > 0.0:
        pools = find_pools(organ, cut_sections(organ), liquid, T_world_patient)
    return LumenContents(contents, spheres.at(centers), pools)
