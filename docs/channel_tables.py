"""Writes the tables of image channels in the docs from their declarations.

    python docs/channel_tables.py

Channels are declared in `vrcaps.render.channels`; a test checks that the tables are
up to date.
"""

from __future__ import annotations

from pathlib import Path

from vrcaps.render.channels import CHANNELS, file_text, invalid_text, unit_text, value_text

BEGIN, END = "<!-- channels: written by docs/channel_tables.py -->", "<!-- end of channels -->"
FOLDER = Path(__file__).parent


def meanings() -> str:
    """Table of what channels mean, for conventions.md."""
    lines = ["| channel | meaning | unit |", "|---|---|---|"]
    lines += [f"| `{c.name}` | {c.description} | {unit_text(c)} |" for c in CHANNELS.values()]
    return "\n".join(lines)


def encodings() -> str:
    """Table of how channels are stored, for episode-format.md."""
    lines = ["| channel | file | value | no value |", "|---|---|---|---|"]
    for channel in CHANNELS.values():
        texts = (
            f"`{channel.name}`",
            file_text(channel),
            value_text(channel),
            invalid_text(channel),
        )
        lines.append(f"| {' | '.join(texts)} |")
    return "\n".join(lines)


TABLES = {"reference/conventions.md": meanings, "reference/episode-format.md": encodings}


def with_table(text: str, table: str) -> str:
    """A page with the table between its two marks."""
    before, _, rest = text.partition(BEGIN)
    _, _, after = rest.partition(END)
    return f"{before}{BEGIN}\n{table}\n{END}{after}"


def main() -> None:
    """Write both tables."""
    for name, table in TABLES.items():
        path = FOLDER / name
        path.write_text(with_table(path.read_text("utf-8"), table()), encoding="utf-8")


if __name__ == "__main__":
    main()
