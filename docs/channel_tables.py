"""Writes the tables of image channels in the docs from their declarations.

    python docs/channel_tables.py

Channels are declared in `vrcaps.render.channels`; a test checks that the tables are
up to date.
"""

from __future__ import annotations

from pathlib import Path

from vrcaps.render.channels import CHANNELS, Channel
from vrcaps.render.encoding import Encoding

BEGIN, END = "<!-- channels: written by docs/channel_tables.py -->", "<!-- end of channels -->"
FOLDER = Path(__file__).parent


def meanings() -> str:
    """Table of what channels mean, for conventions.md."""
    lines = ["| channel | meaning | unit |", "|---|---|---|"]
    lines += [f"| `{c.name}` | {c.description} | {_unit(c)} |" for c in CHANNELS.values()]
    return "\n".join(lines)


def encodings() -> str:
    """Table of how channels are stored, for episode-format.md."""
    lines = ["| channel | file | value | no value |", "|---|---|---|---|"]
    for channel in CHANNELS.values():
        cells = f"`{channel.name}`", _file(channel.encoding), _value(channel), _invalid(channel)
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


TABLES = {"conventions.md": meanings, "episode-format.md": encodings}


def with_table(text: str, table: str) -> str:
    """A page with the table between its two marks."""
    before, _, rest = text.partition(BEGIN)
    _, _, after = rest.partition(END)
    return f"{before}{BEGIN}\n{table}\n{END}{after}"


def _unit(channel: Channel) -> str:
    return "" if channel.unit in ("1", "class", "number") else channel.unit


def _file(encoding: Encoding) -> str:
    planes = "" if encoding.planes == 1 else f", {encoding.planes} planes"
    if encoding.suffix == ".npy":
        return f"{encoding.dtype} `.npy`{planes}"
    return f"{encoding.dtype.removeprefix('uint')}-bit PNG{planes}"


def _value(channel: Channel) -> str:
    encoding, meaning = channel.encoding, channel.meaning
    if encoding.is_mask:
        return f"255 where the {meaning}"
    if encoding.is_packed:
        return f"{meaning}: R + 256 G + 65536 B − 1"
    if encoding.scale is None:
        return channel.description if not _unit(channel) else f"{meaning} [{channel.unit}]"
    zero = round(-encoding.offset / encoding.scale)
    stored = f"(stored − {zero})" if zero else "stored"
    per_unit = round(1.0 / encoding.scale)
    scaled = f"{stored} · {_length(encoding.scale)}" if channel.unit == "m" else ""
    unit = f" [{_unit(channel)}]" if _unit(channel) and not scaled else ""
    return f"{meaning}{unit}: {scaled or f'{stored} / {per_unit}'}"


def _length(scale: float) -> str:
    """A step [m] in a readable unit."""
    return f"{scale * 1e3:g} mm" if scale >= 1e-4 else f"{scale * 1e6:g} µm"


def _invalid(channel: Channel) -> str:
    encoding = channel.encoding
    if channel.name == "rgb":
        return "black"
    if encoding.components == 2:
        return "third plane 0"
    if encoding.suffix == ".npy":
        return "NaN" if encoding.invalid == "NaN" else "0"
    return " ".join("0" * encoding.planes)


def main() -> None:
    """Write both tables."""
    for name, table in TABLES.items():
        path = FOLDER / name
        path.write_text(with_table(path.read_text("utf-8"), table()), encoding="utf-8")


if __name__ == "__main__":
    main()
