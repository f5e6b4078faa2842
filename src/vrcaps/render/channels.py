"""Image channels: one declaration per channel, used everywhere, and the arrays of the core.

A field of `Frame` declares a channel: its type and, in `channel(...)`, its meaning, requirements,
storage and display. The renderer, recordings, previews, checks and the tables in docs/ read these
declarations. To add a channel, see docs/extending.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from vrcaps import _core
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.units import UM
from vrcaps.render.encoding import Encoding, distance, fixed_point, flow, index, numbers

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int, UInt8, UInt16
    from numpy.typing import NDArray

    from vrcaps.camera.camera import Camera
    from vrcaps.world.model import State

Stage = Literal["core", "motion", "dome"]
"""Stage that computes a channel: the compiled core (one pass), the comparison of neighboring
frames, or the camera pipeline, which knows the matter on the dome."""

Display = Literal[
    "image", "color", "vector", "scalar", "class", "instance", "index", "mask", "flow"
]
"""Display of a channel: as is, as linear color, as vector components, by a color map, in distinct
colors for classes, instances or list indices, in black and white, or with direction as hue."""


@dataclass(frozen=True)
class Channel:
    """One image channel.

    Attributes:
        name: Name of the channel, of its field of `Frame` and of the core's array.
        dtype: Type of its values in memory.
        meaning: Meaning of a pixel's value.
        encoding: Storage encoding; includes unit and components.
        display: Display of the values.
        limits: Values at both ends of the color map; None: a percentile of the values shown.
        class_names: Names of the values 0, 1, … if they are the same for all organs.
        stage: Stage that computes it.
        needs: Neighboring states that it needs.
        if_empty: Value for an empty lumen, for channels of lumen contents; None for others.
    """

    name: str
    dtype: str
    meaning: str
    encoding: Encoding
    display: Display
    limits: tuple[float | None, float | None] = (0.0, 1.0)
    class_names: tuple[str, ...] = ()
    stage: Stage = "core"
    needs: frozenset[Literal["next", "previous"]] = frozenset()
    if_empty: float | None = None

    def __str__(self) -> str:
        return self.name

    @property
    def description(self) -> str:
        """Meaning, with the name of each value if names are the same for all organs."""
        names = ", ".join(f"{value} {name}" for value, name in enumerate(self.class_names))
        return f"{self.meaning}: {names}" if names else self.meaning

    @property
    def unit(self) -> str:
        """Unit of the values."""
        return self.encoding.unit

    @property
    def is_light(self) -> bool:
        """True for light: an image or radiance, which supersampling averages."""
        return self.unit in ("sRGB", "W/(sr·m²)")

    @property
    def is_categorical(self) -> bool:
        """True if its values are categories, so neighbors must not be averaged."""
        return self.display in ("class", "instance", "index", "mask")

    def shape(self, height: int, width: int) -> tuple[int, ...]:
        """Shape of its array."""
        components = self.encoding.components
        return (height, width) if components == 1 else (height, width, components)


def channel(dtype: str, meaning: str, encoding: Encoding, display: Display, **more: Any) -> Any:
    """Field of `Frame` that declares a channel; `more` are further attributes of `Channel`."""
    declared = {"dtype": dtype, "meaning": meaning, "encoding": encoding, "display": display}
    return field(default=None, metadata=declared | more)


_ALL = (None, None)


@dataclass(frozen=True)
class Frame:
    """Channels of one image of a camera; None for channels that were not requested.

    Where a pixel sees no surface, float channels hold NaN (`rgb` and `radiance` are black,
    `label` and `instance` are 0, `face` is −1).

    Example:
        >>> frame = renderer.render(state, "front", channels=("rgb", "depth", "label"))
        >>> is_polyp = frame.label == model.organ.label_names.index("polyp")
    """

    rgb: UInt8[np.ndarray, "h w 3"] | None = channel(
        "uint8", "color image", numbers("sRGB", "uint8", 3), "image"
    )
    radiance: Float[np.ndarray, "h w 3"] | None = channel(
        "float32",
        "linear radiance",
        numbers("W/(sr·m²)", "float32", 3),
        "color",
        limits=(0.0, None),
    )
    depth: Float[np.ndarray, "h w"] | None = channel(
        "float32", "z of the surface in the camera frame", distance(), "scalar", limits=_ALL
    )
    ray_distance: Float[np.ndarray, "h w"] | None = channel(
        "float32",
        "distance along the pixel's ray",
        distance(),
        "scalar",
        limits=_ALL,
    )
    normal: Float[np.ndarray, "h w 3"] | None = channel(
        "float32",
        "smooth surface normal in the camera frame, facing the camera",
        fixed_point("1", 1 / 32767, offset=-32768 / 32767, components=3),
        "vector",
        limits=(-1.0, 1.0),
    )
    label: UInt8[np.ndarray, "h w"] | None = channel(
        "uint8",
        "segment or tissue class",
        numbers("class", "uint8"),
        "class",
    )
    instance: UInt16[np.ndarray, "h w"] | None = channel(
        "uint16", "lesion ID", numbers("number", "uint16"), "instance"
    )
    albedo: Float[np.ndarray, "h w 3"] | None = channel(
        "float32",
        "linear base color",
        fixed_point("1", 1 / 65534, offset=-1 / 65534, components=3),
        "color",
    )
    # Stored 1 is 0 m; 65535 is 13.1 m, more than a whole gut.
    arc_length: Float[np.ndarray, "h w"] | None = channel(
        "float32",
        "gut coordinate of the surface from the oral end",
        fixed_point("m", 200 * UM, offset=-200 * UM),
        "scalar",
        limits=_ALL,
    )
    position: Float[np.ndarray, "h w 3"] | None = channel(
        "float32",
        "surface point in the world frame",
        Encoding("m", "float32", 3, ".npy", invalid="NaN"),
        "vector",
        limits=_ALL,
    )
    face: Int[np.ndarray, "h w"] | None = channel(
        "int32", "triangle of the wall, by its index in `organ.glb`, from 0", index(), "index"
    )
    flow_forward: Float[np.ndarray, "h w 2"] | None = channel(
        "float32",
        "motion of the surface point's image to the next frame",
        flow(),
        "flow",
        limits=(0.0, None),
        stage="motion",
        needs=frozenset({"next"}),
    )
    flow_backward: Float[np.ndarray, "h w 2"] | None = channel(
        "float32",
        "motion of the surface point's image to the previous frame",
        flow(),
        "flow",
        limits=(0.0, None),
        stage="motion",
        needs=frozenset({"previous"}),
    )
    occlusion: Bool[np.ndarray, "h w"] | None = channel(
        "bool",
        "surface point is not seen in the next frame (hidden or out of view)",
        Encoding("1", "uint8", 1, is_mask=True),
        "mask",
        stage="motion",
        needs=frozenset({"next"}),
    )
    foreground_label: UInt8[np.ndarray, "h w"] | None = channel(
        "uint8",
        "nearest medium in front of the surface",
        numbers("class", "uint8"),
        "class",
        class_names=("nothing", "bubble", "liquid"),
        if_empty=0,
    )
    foreground_instance: UInt16[np.ndarray, "h w"] | None = channel(
        "uint16",
        "bubble or pool in front of the surface",
        numbers("number", "uint16"),
        "instance",
        if_empty=0,
    )
    foreground_depth: Float[np.ndarray, "h w"] | None = channel(
        "float32",
        "z of the foreground in the camera frame",
        distance(),
        "scalar",
        limits=_ALL,
        if_empty=np.nan,
    )
    refraction_label: UInt8[np.ndarray, "h w"] | None = channel(
        "uint8",
        "deflection of the ray by the surface of a pool",
        numbers("class", "uint8"),
        "class",
        class_names=("straight", "refracted", "reflected"),
        if_empty=0,
    )
    dome_label: UInt8[np.ndarray, "h w"] | None = channel(
        "uint8",
        "matter on the dome",
        numbers("class", "uint8"),
        "class",
        class_names=("nothing", "drop", "smear"),
        stage="dome",
    )


CHANNELS: Mapping[str, Channel] = MappingProxyType(
    {each.name: Channel(each.name, **each.metadata) for each in fields(Frame)}
)
"""All channels by name, in the order of `Frame`."""


def unit_text(channel: Channel) -> str:
    """Unit of a channel; empty for plain numbers."""
    return "" if channel.unit in ("1", "class", "number") else channel.unit


def file_text(channel: Channel) -> str:
    """File type of a channel, such as ``16-bit PNG, 3 planes``."""
    encoding = channel.encoding
    planes = "" if encoding.planes == 1 else f", {encoding.planes} planes"
    if encoding.suffix == ".npy":
        return f"{encoding.dtype} `.npy`{planes}"
    return f"{encoding.dtype.removeprefix('uint')}-bit PNG{planes}"


def value_text(channel: Channel) -> str:
    """Meaning of a pixel's value, with the formula that decodes the stored numbers."""
    encoding, meaning = channel.encoding, channel.meaning
    if encoding.is_mask:
        return f"255 where the {meaning}"
    if encoding.is_packed:
        return f"{meaning}: R + 256 G + 65536 B − 1"
    if encoding.scale is None:
        return channel.description if not unit_text(channel) else f"{meaning} [{channel.unit}]"
    zero = round(-encoding.offset / encoding.scale)
    stored = f"(stored − {zero})" if zero else "stored"
    per_unit = round(1.0 / encoding.scale)
    scaled = f"{stored} · {_length(encoding.scale)}" if channel.unit == "m" else ""
    unit = f" [{unit_text(channel)}]" if unit_text(channel) and not scaled else ""
    return f"{meaning}{unit}: {scaled or f'{stored} / {per_unit}'}"


def invalid_text(channel: Channel) -> str:
    """Stored numbers that mean no value."""
    encoding: Encoding = channel.encoding
    if channel.name == "rgb":
        return "black"
    if encoding.components == 2:
        return "third plane 0"
    if encoding.suffix == ".npy":
        return "NaN" if encoding.invalid == "NaN" else "0"
    return " ".join("0" * encoding.planes)


def _length(scale: float) -> str:
    """Format a step [m] in a readable unit."""
    return f"{scale * 1e3:g} mm" if scale >= 1e-4 else f"{scale * 1e6:g} µm"


RADIANCE_PLANAR = "radiance_planar"
"""Name of the core's array of radiance by color, with a margin."""


def check_channels(channels: Sequence[str], following: State | None, earlier: State | None) -> None:
    """Check that channels exist and have the states that they need.

    Raises:
        UnknownNameError: If there is no such channel.
        InputError: If a channel needs a state that was not given.
    """
    given = {"next": following, "previous": earlier}
    for name in channels:
        if name not in CHANNELS:
            raise UnknownNameError("channel", name, CHANNELS)
        for neighbor in CHANNELS[name].needs:
            if given[neighbor] is None:
                raise InputError(
                    f"Channel {name!r} needs the {neighbor} state. Give state_{neighbor}."
                )


def needs(channels: Sequence[str]) -> set[str]:
    """Neighboring states that channels need."""
    return {neighbor for name in channels for neighbor in CHANNELS[name].needs}


def layout(name: str, camera: Camera) -> tuple[tuple[int, ...], np.dtype]:
    """Shape and dtype of an array that the core fills."""
    if name == "weights":  # of the triangle's corners at the material point of each pixel
        return (camera.height, camera.width, 2), np.dtype(np.float32)
    return CHANNELS[name].shape(camera.height, camera.width), np.dtype(CHANNELS[name].dtype)


def is_light(name: str) -> bool:
    """Check whether an array holds light, which gets indirect light and supersampling."""
    return name == RADIANCE_PLANAR or (name in CHANNELS and CHANNELS[name].is_light)


def fill_empty(arrays: dict[str, NDArray[Any]]) -> None:
    """Fill channels of lumen contents for an empty lumen."""
    for name, array in arrays.items():
        if name in CHANNELS and (value := CHANNELS[name].if_empty) is not None:
            array.fill(value)
    if "sparse_refraction" in arrays:
        arrays["sparse_refraction"].fill(CHANNELS["refraction_label"].if_empty)


def write_light(
    radiance: Float[np.ndarray, "h w 3"], exposure: float, arrays: dict[str, NDArray[Any]]
) -> None:
    """Write radiance [W/(sr·m²)], and the image of it at an exposure, where they are requested."""
    if "radiance" in arrays:
        arrays["radiance"][...] = radiance
    if "rgb" in arrays:
        arrays["rgb"][...] = _core.encode_srgb(radiance, exposure)
