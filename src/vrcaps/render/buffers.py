"""Arrays that the core fills: shapes, requirements of channels, and values of an empty lumen."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.render.channels import CHANNELS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from vrcaps.camera.camera import Camera
    from vrcaps.world.model import State

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
