"""Dynamics of the capsule: with inertia or quasi-static.

`physics` integrates the Newton-Euler equations in substeps of 50 µs. `quasi-static` neglects
inertia: the capsule moves at the twist ξ (velocity and angular velocity) for which

    M ξ/τ + contact(pose, ξ) + friction(ξ) = F(pose) + gravity + commands

with the mass matrix M, the wall's pressure and friction, and the wrench F of sources. A step is
divided into parts of at most 1/60 s in which no point of the capsule moves more than 0.5 mm. Each
is solved implicitly (backward Euler), with the stiffness of the sources' wrench, together with the
spring wall under the capsule, which also has no inertia: m μ ẋ + k x = F_v. A capsule that would
need more than 1500 parts per second, at 0.75 m/s next to a wall, is slowed down.

M ξ/τ is the drag of the lumen contents, by which momentum decays with the relaxation time τ of
`Drag`, by default 0.1 s. `physics` has the same drag, by default none. With the default a capsule
sinks freely at g τ = 0.98 m/s, and a force 1 mN above friction moves a capsule of 3 g at 33 mm/s.
Effects of momentum are absent: a capsule does not coast, bounce or swing. Where it does in
`physics`, pushed by a wrench or in a fall, the two differ; led by a magnet they agree, see
docs/results/validation.md.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, get_args

from vrcaps.core.errors import InputError, UnknownNameError, require
from vrcaps.tissue.fem.deformation import FemDeformation

if TYPE_CHECKING:
    from vrcaps.tissue.tissue import Tissue
    from vrcaps.world.model import Model

RELAXATION_TIME = 0.1
"""Default relaxation time τ of quasi-static motion [s], where `Drag` has none; as in the core."""

DynamicsKind = Literal["physics", "quasi-static"]
"""Names of dynamics."""

DYNAMICS: tuple[DynamicsKind, ...] = get_args(DynamicsKind)


def check_dynamics(name: str, model: Model, tissue: Tissue) -> None:
    """Check that the dynamics exist and support a model and a tissue.

    Raises:
        InputError: If quasi-static motion is combined with an elastic layer, lumen contents or no
            drag.
        UnknownNameError: If no dynamics have that name.
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
