"""Text descriptions of stored channels, for the pages of docs/ and for data cards."""

from __future__ import annotations

from vrcaps.render.channels import Channel
from vrcaps.render.encoding import Encoding


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
