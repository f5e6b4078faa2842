"""Distributions that are sampled at each reset: initial pose, and tissue, capsule and camera."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Annotated

import numpy as np

from vrcaps.camera.derive import scaled_lens
from vrcaps.camera_pipeline.effects import Effects, parse_effects
from vrcaps.core.errors import InputError
from vrcaps.core.fields import Range, check_fields
from vrcaps.motion.trajectory import start_pose
from vrcaps.tissue.fem.deformation import FemDeformation
from vrcaps.tissue.tissue import SpringWall
from vrcaps.world.model import Model, State

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.camera.camera import Camera
    from vrcaps.capsule.device import Device
    from vrcaps.tissue.tissue import Tissue

Factor = float | tuple[float, float]
"""A number, or the limits of a uniform distribution that is sampled at each reset."""

FACTORS = ("stiffness", "friction", "drag", "mass", "magnet", "focal")
"""Randomized quantities, in the order of `Randomization.draw`."""

_MAX_FACTOR = 100.0
_NUM_FOCALS = 9
_REFUSED = (
    "specular",
    "dome_bubbles",
    "resolution",
    "motion_blur",
    "rolling_shutter",
    "adaptive_frame_rate",
    "random",
)
"""Effects that change the wall or an image's size or time, or need neighboring frames."""


@dataclass(frozen=True)
class Randomization:
    """Random factors on physical parameters, and camera effects on images.

    Each factor is a number, or a range that is sampled in every episode.

    Example:
        >>> varied = Randomization(friction=(0.5, 2.0), mass=(0.9, 1.1), magnet=0.8)

    Attributes:
        stiffness: Stiffness of the wall: modulus of its foundation, stiffness of springs or layer.
        friction: Coefficient of friction of the wall.
        drag: Drag of the lumen contents, viscosity of the mucus, and resistance of the laws
            `incetan2021` and `continuous`.
        mass: Mass of the capsule. A controller that balances its weight knows only the nominal
            mass.
        magnet: Moment of the magnets in the capsule.
        focal: Focal length of its cameras; a range is sampled at nine equidistant values.
        effects: Camera effects on image observations; a range of severities is sampled as well.
            Effects that need other frames or change the wall are not allowed. A string is parsed by
            `parse_effects`, such as ``noise=1..3,bloom=2``.
    """

    stiffness: Factor = 1.0
    friction: Factor = 1.0
    drag: Factor = 1.0
    mass: Factor = 1.0
    magnet: Factor = 1.0
    focal: Factor = 1.0
    effects: Effects | str = field(default_factory=Effects)

    def __post_init__(self) -> None:
        check_fields(self, of="Randomization")
        if isinstance(self.effects, str):
            object.__setattr__(self, "effects", parse_effects(self.effects))
        for name in FACTORS:
            value = getattr(self, name)
            ends = np.array(value, float).ravel()
            is_range = len(ends) in (1, 2) and bool(np.all((ends > 0.0) & (ends <= _MAX_FACTOR)))
            if not is_range or ends[0] > ends[-1]:
                raise InputError(
                    f"Randomization's {name} is {value}. Allowed: a factor above 0 to "
                    f"{_MAX_FACTOR:g}, or an ascending range of these."
                )
        for name in _REFUSED:
            if getattr(self.effects, name) not in (0, None):
                raise InputError(
                    f"Randomization's effects hold {name}, which needs a recording. Allowed in an "
                    f"environment: all but {', '.join(_REFUSED)}."
                )

    def sample_effects(self, seed: int) -> Effects:
        """Sample a severity from each range of the effects."""
        assert not isinstance(self.effects, str)  # the constructor has parsed a string
        return self.effects.sample(seed)

    @property
    def has_effects(self) -> bool:
        """Return whether images differ from those of the ideal camera."""
        return self.effects != Effects()

    def draw(self, rng: np.random.Generator) -> tuple[Float[np.ndarray, " 6"], int]:
        """Sample factors in the order of `FACTORS` and a seed for effects.

        Fixed values consume no random numbers.
        """
        factors = []
        for name in FACTORS:
            value = getattr(self, name)
            if isinstance(value, tuple | list):
                low, high = value
                part = rng.random()
                if name == "focal":
                    part = math.floor(part * _NUM_FOCALS) / (_NUM_FOCALS - 1)
                value = low + part * (high - low)
            factors.append(float(value))
        return np.array(factors), int(rng.integers(2**31)) if self.has_effects else 0


def varied_tissue(tissue: Tissue, factors: Float[np.ndarray, " 6"]) -> Tissue:
    """Apply drawn factors to the stiffness, friction and drag of a tissue."""
    stiffness, friction, drag = factors[:3].tolist()
    if stiffness == friction == drag == 1.0:
        return tissue
    foundation, law, wall = tissue.foundation, tissue.drag, tissue.deformation
    modulus = stiffness * foundation.youngs_modulus
    if isinstance(wall, SpringWall):
        wall = replace(wall, stiffness=stiffness * wall.stiffness)
    elif isinstance(wall, FemDeformation):
        wall = replace(wall, youngs_modulus=stiffness * wall.youngs_modulus)
    law = replace(
        law,
        friction=friction * law.friction,
        viscosity=drag * law.viscosity,
        a=drag * law.a,
        constant=drag * law.constant,
        relaxation_time=None if law.relaxation_time is None else law.relaxation_time / drag,
    )
    foundation = replace(foundation, youngs_modulus=modulus)
    return replace(tissue, foundation=foundation, drag=law, deformation=wall)


def varied_device(device: Device, factors: Float[np.ndarray, " 6"]) -> Device:
    """Apply drawn factors to the mass, magnets and lenses of a capsule."""
    mass, magnet, focal = factors[3:].tolist()
    if mass == magnet == focal == 1.0:
        return device
    magnets = tuple(
        replace(m, moment_capsule=tuple(magnet * x for x in m.moment_capsule))
        for m in device.magnets
    )
    cameras = device.cameras if focal == 1.0 else _magnified(device.cameras, focal)
    return replace(device, mass=mass * device.mass, magnets=magnets, cameras=cameras)


@lru_cache(maxsize=64)
def _magnified(cameras: tuple[Camera, ...], focal: float) -> tuple[Camera, ...]:
    """Scale the focal lengths of cameras; cached, so that equal input gives the same object."""
    return tuple(
        replace(c, lens=scaled_lens(c.lens, focal, (c.lens.cx, c.lens.cy))) for c in cameras
    )


@dataclass(frozen=True)
class Start:
    """Initial pose of an episode; each value is drawn uniformly between its two limits.

    Attributes:
        fraction: Position along the centerline, as a fraction; moved to where the capsule fits.
        angle: Angle between the capsule's front and the direction to the anal end [rad].
        settle: Time for the capsule to come to rest before the first observation [s].
    """

    fraction: tuple[float, float] = (0.1, 0.9)
    angle: tuple[float, float] = (0.0, 0.0)
    settle: Annotated[float, Range(min=0.0, max=10.0, unit="s")] = 0.5

    def __post_init__(self) -> None:
        check_fields(self)
        low, high = self.fraction
        if not 0.0 <= low <= high <= 1.0:
            raise InputError(f"Start's fraction is {self.fraction}. Allowed: 0 to 1, ascending.")
        if not all(map(math.isfinite, self.angle)) or self.angle[0] > self.angle[1]:
            raise InputError(f"Start's angle is {self.angle}. Allowed: finite [rad], ascending.")

    def draw(self, model: Model, rng: np.random.Generator) -> tuple[State, float]:
        """Draw a state at rest; returns it and its arc length [m].

        Raises:
            InputError: If the capsule does not fit in the organ.
        """
        place, angle = (float(rng.uniform(*limits)) for limits in (self.fraction, self.angle))
        T_world_capsule, arc_length, _ = start_pose(model, place, angle)
        return State(0.0, T_world_capsule), arc_length
