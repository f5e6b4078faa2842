"""Effects of a recording: each by severity, by a range of severities, or by exact parameters.

Those of the capsule itself are drawn for one unit from the image chain of its model.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, Literal, get_args, get_type_hints

import numpy as np

from vrcaps.camera_pipeline.effect.base import (
    MAX_SEVERITY,
    CameraEffect,
    Effect,
    ImageEffect,
    SceneEffect,
    Severity,
)
from vrcaps.camera_pipeline.effect.dome import Droplets, Smears
from vrcaps.camera_pipeline.effect.exposure import (
    AdaptiveFrameRate,
    AutoExposure,
    MotionBlur,
    RollingShutter,
)
from vrcaps.camera_pipeline.effect.optics import (
    Bloom,
    DepthOfField,
    Distortion,
    FieldOfView,
    LateralChromaticAberration,
    LedBalance,
    Vignetting,
)
from vrcaps.camera_pipeline.effect.processing import (
    MAX_ELEMENT,
    MAX_FILTER_WIDTH,
    ColorMatrix,
    Denoising,
    Jpeg,
    Sharpening,
    ToneCurve,
    WhiteBalance,
)
from vrcaps.camera_pipeline.effect.scene import DomeBubbles, SpecularReflection
from vrcaps.camera_pipeline.effect.sensor import BayerFilter, Resolution, SensorNoise
from vrcaps.capsule.image_chain import EQUAL_UNITS
from vrcaps.core.errors import InputError, UnknownNameError, require
from vrcaps.core.fields import plain_fields
from vrcaps.core.rng import stream, truncated_normal

if TYPE_CHECKING:
    from typing import TypeVar

    from vrcaps.capsule.device import Device
    from vrcaps.lumen.contents import Contents
    from vrcaps.organ.surface import OrganSurface

    Kind = TypeVar("Kind", bound=Effect)
    from vrcaps.camera_pipeline.effect.base import Effect
    from vrcaps.capsule.image_chain import ImageChain


_FLAGS = ("random", "nominal")
"""Fields of `Effects` that are not effects."""


@dataclass(frozen=True)
class Effects:
    """Effects of lens, sensor and recorder on the images, in this order.

    Each field is a severity from 0 (off) to 4, a range of severities from which a recording samples
    one, or the effect with exact parameters. None is the capsule's own, see `of_device`, and leaves
    the scene unchanged. The class of a field documents the effect. To add an effect, add its class
    to the file of its stage in `camera_pipeline/effect` and its field here. With `random`, a
    recording also samples three to five of the effects that are None, at severity 1 or 2. With
    `nominal`, the capsule's own are those of its model, without the differences between units.

    Example:
        >>> effects = vrcaps.Effects(depth_of_field=2, sensor_noise=(1, 3), jpeg=1)
        >>> vrcaps.record(vrcaps.Scenario(effects=effects), "runs/real")
    """

    specular: Severity | SpecularReflection | None = None
    dome_bubbles: Severity | DomeBubbles | None = None
    led_balance: Severity | LedBalance | None = None
    field_of_view: Severity | FieldOfView | None = None
    distortion: Severity | Distortion | None = None
    resolution: Severity | Resolution | None = None
    motion_blur: Severity | MotionBlur | None = None
    rolling_shutter: Severity | RollingShutter | None = None
    depth_of_field: Severity | DepthOfField | None = None
    droplets: Severity | Droplets | None = None
    smears: Severity | Smears | None = None
    chromatic_aberration: Severity | LateralChromaticAberration | None = None
    vignetting: Severity | Vignetting | None = None
    bloom: Severity | Bloom | None = None
    auto_exposure: Severity | AutoExposure | None = None
    sensor_noise: Severity | SensorNoise | None = None
    bayer_filter: Literal[0] | BayerFilter | None = None
    white_balance: Severity | WhiteBalance | None = None
    color_matrix: Severity | ColorMatrix | None = None
    tone_curve: Severity | ToneCurve | None = None
    denoising: Severity | Denoising | None = None
    sharpening: Severity | Sharpening | None = None
    jpeg: Severity | Jpeg | None = None
    adaptive_frame_rate: Literal[0] | AdaptiveFrameRate | None = None
    random: bool = False
    nominal: bool = False

    def __post_init__(self) -> None:
        plain_fields(self)
        for name in _FLAGS:
            value = getattr(self, name)
            require(isinstance(value, bool), name, repr(value), "True or False")
        for name, kind in EFFECTS.items():
            _check(kind, getattr(self, name))

    @classmethod
    def none(cls) -> Effects:
        """Effects of an ideal camera with fixed exposure: `none` of `parse_effects`."""
        return replace(cls(), **dict.fromkeys(_OF_CAMERA, 0))  # type: ignore[arg-type]

    def of_device(self, device: Device, seed: int | None = None) -> Effects:
        """Return the effects with each None replaced by the capsule's own.

        A capsule with an image chain has that of the unit of the seed, one with automatic exposure
        has it settled in every frame, and one that states a minimum frame rate adapts its frame
        rate. All other effects of the camera are off; the scene is unchanged.

        Args:
            device: The capsule.
            seed: Seed of the unit; None for the nominal values of its model, as with `nominal`.
        """
        seed = None if self.nominal else seed
        own: dict[str, Any] = dict.fromkeys(_OF_CAMERA, 0)
        if device.image_chain is not None:
            own |= unit_effects(device.image_chain, seed)
        if device.auto_exposure:
            own["auto_exposure"] = _settled_exposure(device.image_chain, seed)
        if device.lowest_frame_rate is not None:
            own["adaptive_frame_rate"] = AdaptiveFrameRate(
                device.lowest_frame_rate, device.frame_rate
            )
        own = {k: v for k, v in own.items() if getattr(self, k) is None}
        return replace(self, nominal=False, **own)

    def without_device(self, device: Device, seed: int | None = None) -> Effects:
        """Return the inverse of `of_device`: None for each effect equal to the capsule's own."""
        own = Effects().of_device(device, seed)
        same = [name for name in _OF_CAMERA if getattr(self, name) == getattr(own, name)]
        return replace(self, **dict.fromkeys(same))

    def sample(self, seed: int) -> Effects:
        """Return the effects with a severity sampled from each range, determined by the seed.

        A severity of a range does not depend on the presence of other effects.
        """
        severities = self._random_severities(seed) if self.random else {}
        for name in SEVERITIES:
            value = getattr(self, name)
            if isinstance(value, tuple):
                rng = stream(seed, f"camera/severity/{name}")
                severities[name] = int(rng.integers(value[0], value[1], endpoint=True))
        return replace(self, random=False, **severities)  # type: ignore[arg-type]

    def _random_severities(self, seed: int) -> dict[str, int]:
        """Severities of a few of the effects that are None."""
        rng = stream(seed, "camera/random")
        names = [name for name in SEVERITIES if getattr(self, name) is None]
        count = min(int(rng.integers(*_RANDOM_COUNT, endpoint=True)), len(names))
        chosen = rng.permutation(len(names))[:count]
        return {names[i]: int(rng.integers(*_RANDOM_SEVERITY, endpoint=True)) for i in chosen}

    def resolve(self, name: str) -> Any:
        """Return one effect with its parameters; None if it is off.

        Raises:
            InputError: If it is still a range of severities, or random.
        """
        if self.random:
            raise InputError("Effects are random. Call sample(seed) first.")
        value = getattr(self, name)
        if isinstance(value, tuple):
            raise InputError(f"Effect {name} is a range of severities. Call sample(seed) first.")
        return SEVERITIES.get(name, (None,))[value] if isinstance(value, int) else value

    def of_kind(self, kind: type[Kind]) -> tuple[Kind, ...]:
        """Effects of a kind that are on, in their order."""
        names = [name for name, cls in EFFECTS.items() if issubclass(cls, kind)]
        effects = (self.resolve(name) for name in names)
        return tuple(effect for effect in effects if effect is not None)

    @property
    def is_ideal(self) -> bool:
        """True if no stage changes the image; the scene and the camera may still be changed."""
        names = [name for name, cls in EFFECTS.items() if issubclass(cls, ImageEffect)]
        return all(getattr(self, name) in (0, None) for name in names)

    def device(self, device: Device) -> Device:
        """Return the capsule with the camera effects applied to its cameras."""
        cameras = device.cameras
        for effect in self.of_kind(CameraEffect):
            cameras = tuple(effect.on(camera) for camera in cameras)
        return device if cameras is device.cameras else replace(device, cameras=cameras)

    def organ(self, organ: OrganSurface) -> OrganSurface:
        """Return the organ with the scene effects applied."""
        for effect in self.of_kind(SceneEffect):
            organ = effect.on_organ(organ)
        return organ

    def contents(self, contents: Contents) -> Contents:
        """Return the contents of the lumen with the scene effects applied."""
        for effect in self.of_kind(SceneEffect):
            contents = effect.on_contents(contents)
        return contents


def _check(kind: type[Effect], value: Any) -> None:
    """Check the value of an effect's field.

    Raises:
        InputError: If it is not a severity, a range of severities or an effect of its class.
    """
    if value is None or isinstance(value, kind) or (type(value) is int and value == 0):
        return
    ends = value if isinstance(value, tuple) else (value,)
    given = "..".join(map(str, ends))
    if not kind.severities:
        raise InputError(f"Effect {kind.name} is {given}. Allowed: {kind.__name__}(…), 0 or None.")
    is_range = all(type(end) is int for end in ends)
    is_range = is_range and (not isinstance(value, tuple) or len(ends) == 2)
    if not (is_range and list(ends) == sorted(ends) and 0 <= ends[0] <= ends[-1] <= MAX_SEVERITY):
        raise InputError(
            f"Effect {kind.name} has the severity {given}. Allowed: 0 to {MAX_SEVERITY}, or an "
            "ascending range of these."
        )


def _effect_of(hint: Any) -> type[Effect]:
    """Effect class among the types of a field."""
    members = get_args(hint)
    return next(m for m in members if isinstance(m, type) and issubclass(m, Effect))


EFFECTS: dict[str, type[Effect]] = {
    f.name: _effect_of(get_type_hints(Effects)[f.name])
    for f in fields(Effects)
    if f.name not in _FLAGS
}
"""Classes of all effects by name, in their order."""

SEVERITIES: dict[str, tuple[Any, ...]] = {
    name: tuple(map(kind.at, range(MAX_SEVERITY + 1)))
    for name, kind in EFFECTS.items()
    if kind.severities
}
"""Each effect at every severity; None if it is off."""

_OF_CAMERA = [name for name, kind in EFFECTS.items() if not issubclass(kind, SceneEffect)]

SHORT_NAMES = {kind.short: name for name, kind in EFFECTS.items() if kind.short}
"""Short names of effects."""

_ALL, _NONE, _DEFAULT = "all", "none", "default"
RESETS = (_DEFAULT, "nominal", _NONE, "random")
"""Items of `parse_effects` that override all effects of the camera."""
_RANDOM_COUNT, _RANDOM_SEVERITY = (3, 5), (1, 2)
"""Ranges of the number of random effects and of their severities: higher ones of several effects
together yield unusable images."""


class _All(Effect):
    """Every effect that has severities, as `all=SEVERITY` names it."""

    name = _ALL
    severities = (None,) * (MAX_SEVERITY + 1)


def parse_effects(text: str) -> Effects:
    """Parse effects from a string such as `specular=3,dof=1`.

    Items are separated by commas; later items override earlier ones: `default` for the capsule's
    own camera, `nominal` for that of its model without differences between units, `none` for an
    ideal camera with fixed exposure, `NAME=SEVERITY`, `NAME=FIRST..LAST` to sample a severity,
    `all=SEVERITY` for every effect, `random` to sample three to five effects at severity 1 or 2;
    `ae=settled`, `bayer=rggb`, and `afr=MIN..MAX` in frames per second. Effects that are not named
    are the capsule's own.

    Raises:
        UnknownNameError: If an effect does not exist.
        InputError: If an item or a severity is invalid.
    """
    values: dict[str, Any] = {}
    for item in (part.strip() for part in text.split(",")):
        name, equals, value = item.partition("=")
        name, value = name.strip().replace("-", "_"), value.strip()
        name = SHORT_NAMES.get(name, name)
        if equals and name in RESETS:
            raise InputError(
                f"{name} has the value {value!r}. Allowed: {name} alone, or all=0 to "
                f"all={MAX_SEVERITY}."
            )
        if name in RESETS:
            values |= dict.fromkeys(_OF_CAMERA, 0 if name == _NONE else None)
            values |= {flag: name == flag for flag in _FLAGS}
        elif name == _ALL:
            severity = _All.parse(value)
            _check(_All, severity)
            values |= dict.fromkeys(SEVERITIES, severity)
        elif name in EFFECTS:
            values[name] = 0 if value == "0" else EFFECTS[name].parse(value)
        else:
            raise UnknownNameError("effect", name, (*EFFECTS, *SHORT_NAMES, _ALL, *RESETS))
    return Effects(**values)


def _settled_exposure(chain: ImageChain | None, seed: int | None) -> AutoExposure:
    """Automatic exposure that has settled in every frame, with the target of the unit."""
    tolerance = 0.0 if chain is None else chain.exposure_tolerance
    nominal = AutoExposure(time_constant=0.0, tolerance=tolerance)
    if chain is None or seed is None or not chain.variation.exposure:
        return nominal
    z = truncated_normal(stream(seed, "camera/unit/exposure"))
    return replace(
        nominal, target=round(nominal.target * math.exp(chain.variation.exposure * z), 5)
    )


_SEEDS = 2**31


def unit_effects(chain: ImageChain, seed: int | None) -> dict[str, Effect]:
    """Effects of one unit of a capsule by name; those that change nothing are left out.

    Args:
        chain: Image chain of the model.
        seed: Seed of the unit; None for the nominal values.
    """
    variation = EQUAL_UNITS if seed is None else chain.variation
    rng = stream(seed or 0, "camera/unit")
    leds, sensor = (int(rng.integers(_SEEDS)) for _ in range(2))
    sensor = 0 if seed is None else sensor
    red, blue, shading, focus = (truncated_normal(rng) for _ in range(4))
    matrix = np.array([[truncated_normal(rng) for _ in range(3)] for _ in range(3)])
    smoothing = math.exp(variation.denoising * truncated_normal(rng))
    balance = variation.white_balance * np.array([red, 0.0, blue])
    coefficients = (1.0 + variation.lens_shading * shading) * np.array(chain.lens_shading)
    sharpening = Sharpening(chain.sharpening, chain.sharpening_radius_px)
    effects: list[Effect | None] = [
        LedBalance(variation.led, variation.led_color, leds) if variation.led else None,
        DepthOfField(chain.aperture, chain.focus_distance * math.exp(variation.focus * focus)),
        LateralChromaticAberration(*chain.lateral_color) if any(chain.lateral_color) else None,
        Vignetting(_triple(coefficients), chain.cosine_power),
        Bloom(chain.bloom_fraction, chain.bloom_angle) if chain.bloom_fraction else None,
        SensorNoise(chain.full_well, chain.read_noise, chain.prnu, chain.dsnu, sensor_seed=sensor),
        BayerFilter(chain.bayer_pattern) if chain.bayer_pattern else None,  # type: ignore[arg-type]
        WhiteBalance(_triple(np.array(chain.white_balance) * np.exp(balance)), chain.response),
        _color_matrix(np.array(chain.color_matrix), variation.color_matrix * matrix),
        ToneCurve(chain.contrast) if chain.contrast != 1.0 else None,
        _denoising(chain, smoothing),
        sharpening if chain.sharpening else None,
        Jpeg(chain.jpeg_quality) if chain.jpeg_quality else None,
    ]
    return {effect.name: effect for effect in effects if effect is not None}


def _denoising(chain: ImageChain, factor: float) -> Denoising:
    """Denoising with the chain's filters wider by a factor, limited to those of `Denoising`."""
    widths = chain.luma_denoising_px, chain.chroma_denoising_px
    luma, chroma = (round(min(factor * width, MAX_FILTER_WIDTH), 4) for width in widths)
    return Denoising(luma, chroma)


def _color_matrix(nominal: np.ndarray, errors: np.ndarray) -> ColorMatrix | None:
    """Matrix with errors off the diagonal, which keep gray; None for the identity.

    Elements are limited to those of `ColorMatrix`.
    """
    errors = errors * (1.0 - np.eye(3))
    matrix = nominal @ (np.eye(3) + errors - np.diag(errors.sum(axis=1)))
    matrix = np.clip(matrix, -MAX_ELEMENT, MAX_ELEMENT)
    if np.array_equal(matrix, np.eye(3)):
        return None
    red, green, blue = (_triple(row) for row in matrix)
    return ColorMatrix((red, green, blue))


def _triple(values: np.ndarray) -> tuple[float, float, float]:
    """Three numbers, rounded to the digits that an episode stores exactly."""
    first, second, third = np.round(values, 6).tolist()
    return first, second, third
