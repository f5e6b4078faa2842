"""Dynamics: how a capsule's motion comes from what acts on it, with inertia or in balance.

`physics` integrates Newton's and Euler's equations in substeps of 50 µs. `quasi-static` leaves
inertia out: the capsule goes at the twist ξ (velocity and angular velocity) at which

    M ξ/τ + contact(pose, ξ) + friction(ξ) = F(pose) + gravity + commands

with the mass matrix M, the wall's pressure and friction, and the wrench F of sources. A step is cut
into parts in which no point of the capsule goes farther than 0.5 mm, of 1/60 s at most; each is
solved implicitly (backward Euler), together with the spring wall under it, which gives way without
inertia too: m μ ẋ + k x = F_v. Sources hold the capsule back by the stiffness of their wrench. A
capsule that would need more than 1500 parts a second, at 0.75 m/s beside a wall, is slower.

M ξ/τ is the drag of what fills the lumen, by which momentum is lost within the relaxation time τ of
`Drag`, by default 0.1 s. `physics` takes the same drag, by default none. With the default a capsule
sinks freely at g τ = 0.98 m/s, and a force that is 1 mN above the friction moves one of 3 g at 33
mm/s. What lives on momentum is not there: a capsule does not coast on, bounce or swing. Where it
does in `physics`, pushed by a wrench or in a fall, the two part; led by a magnet they agree, see
docs/validation.md.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, get_args

from vrcaps.errors import InputError, UnknownNameError, require
from vrcaps.tissue.fem.deformation import FemDeformation

if TYPE_CHECKING:
    from vrcaps.tissue.tissue import Tissue
    from vrcaps.world.model import Model

RELAXATION_TIME = 0.1
"""Relaxation time τ of quasi-static motion where `Drag` gives none [s]; the core's own."""

DynamicsKind = Literal["physics", "quasi-static"]
"""Names of dynamics."""

DYNAMICS: tuple[DynamicsKind, ...] = get_args(DynamicsKind)


def check_dynamics(name: str, model: Model, tissue: Tissue) -> None:
    """Check that there are such dynamics, and that they take a model and a tissue.

    Raises:
        InputError: If quasi-static motion finds an elastic layer, lumen contents or no drag.
        UnknownNameError: If there are none of that name.
    """
    if name not in DYNAMICS:
        raise UnknownNameError("dynamics", name, DYNAMICS)
    if name != "quasi-static":
        return
    tau = tissue.drag.relaxation_time
    require(
        tau is None or tau <= 1e3, "relaxation_time of quasi-static motion", tau, "up to 1000 s"
    )
    refused = "Dynamics are quasi-static, but {} moves with inertia. {}, or choose physics."
    if isinstance(tissue.deformation, FemDeformation):
        raise InputError(refused.format("a layer of finite elements", "Give a spring wall or none"))
    if not model.contents.is_empty:
        raise InputError(refused.format("what floats in the lumen", "Leave the contents out"))
