"""Write the tables of camera effects in docs/concepts/effects.md from their declarations.

python docs/effect_tables.py
"""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from pathlib import Path

from vrcaps.camera_pipeline.effect.base import MAX_SEVERITY, Effect
from vrcaps.camera_pipeline.effects import EFFECTS
from vrcaps.capsule.device_file import read_device
from vrcaps.capsule.image_chain import ImageChain, UnitVariation

PAGE = Path(__file__).parent / "concepts" / "effects.md"

DEVICES = ("mirocam", "pillcam-sb3", "pillcam-colon2", "magnetic", "colonoscope")
"""Capsules with specific values; all others have those of `mirocam`."""

_MARK, _END = "<!-- {} -->", "<!-- end of {} -->"


def severity_table() -> str:
    """Parameters of each effect at every severity, as Markdown; SI units."""
    severities = range(MAX_SEVERITY + 1)
    lines = [
        f"| effect | class | {' | '.join(map(str, severities))} |",
        "|---" * (MAX_SEVERITY + 3) + "|",
    ]
    for name, kind in EFFECTS.items():
        if kind.severities:
            cells = " | ".join(_described(kind.at(severity)) for severity in severities)
            lines.append(f"| `{name}` | `{kind.__name__}` | {cells} |")
    return "\n".join(lines)


def effect_table() -> str:
    """Name, short name and summary of each effect in order, as Markdown."""
    lines = ["| effect | short | acts on | description |", "|---|---|---|---|"]
    for name, kind in EFFECTS.items():
        short = f"`{kind.short}`" if kind.short else ""
        lines.append(f"| `{name}` | {short} | {kind.acts_on} | {kind.summary()} |")
    return "\n".join(lines)


def device_table() -> str:
    """Image chain of each capsule, as Markdown; SI units."""
    chains = [read_device(name).image_chain for name in DEVICES]
    lines = [f"| parameter | {' | '.join(f'`{name}`' for name in DEVICES)} |"]
    lines.append("|---" * (len(DEVICES) + 1) + "|")
    for field in fields(ImageChain):
        values = [getattr(chain, field.name) for chain in chains]
        if not any(map(is_dataclass, values)):
            cells = " | ".join(map(_value_text, values))
            lines.append(f"| `{field.name}` | {cells} |")
    variations = [chain.variation for chain in chains if chain is not None]
    for field in fields(UnitVariation):
        cells = " | ".join(_value_text(getattr(one, field.name)) for one in variations)
        lines.append(f"| `variation.{field.name}` | {cells} |")
    return "\n".join(lines)


def with_tables(page: str) -> str:
    """Return a page with all tables between their marks, such as `<!-- severities -->`."""
    tables = {
        "severities": severity_table(),
        "effects": effect_table(),
        "devices": device_table(),
    }
    for mark, table in tables.items():
        start, end = _MARK.format(mark), _END.format(mark)
        before, after = page.split(start, maxsplit=1)[0], page.split(end)[1]
        page = f"{before}{start}\n{table}\n{end}{after}"
    return page


def _described(effect: Effect | None) -> str:
    """Parameters of an effect that differ from its class defaults."""
    if effect is None:
        return "–"
    parts = []
    for field in fields(effect):  # type: ignore[arg-type]
        value = getattr(effect, field.name)
        if value != field.default:
            parts.append(f"{field.name} {_number_text(value)}")
    return ", ".join(parts)


def _value_text(value: object) -> str:
    return value if isinstance(value, str) else _number_text(value)


def _number_text(value: object) -> str:
    """A number, or a tuple of numbers or of tuples."""
    if isinstance(value, tuple):
        return f"({', '.join(map(_number_text, value))})"
    return f"{value:g}"


if __name__ == "__main__":
    PAGE.write_text(with_tables(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
