"""Write the tables of docs/concepts/lesions.md from the declarations of the lesions.

    python docs/lesion_tables.py

A table stands between the lines ``<!-- table: NAME -->`` and ``<!-- end -->``.
"""

import re
from pathlib import Path

from vrcaps.core.units import CM, MM
from vrcaps.lesion import LESIONS, Colitis, Polyp
from vrcaps.lesion.library import describe_kind

PAGE = Path(__file__).parent / "concepts" / "lesions.md"


def table(head: list[str], rows: list[list[str]]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def kinds() -> str:
    """Each kind with its grades and settings."""
    rows = []
    for kind, cls in sorted(LESIONS.items()):
        grades, settings = describe_kind(cls)
        key = f"`{cls.grade_field}`" if cls.grade_field else ""
        rows.append([f"`{kind}`", grades, key, settings])
    return table(["kind", "grades", "key of the grade in a file", "settings"], rows)


def library() -> str:
    """Number of named lesions of each kind."""
    rows = []
    for kind, cls in LESIONS.items():
        names = list(cls.library())
        if names:
            rows.append([f"`{kind}`", str(len(names)), f"`{names[0]}` to `{names[-1]}`"])
    return table(["kind", "lesions", "names"], rows)


def polyps() -> str:
    """Sizes of the library's polyps, by Paris type and surface."""
    named = [polyp for polyp in Polyp.library().values() if isinstance(polyp, Polyp)]
    patterns = list(dict.fromkeys(polyp.pattern for polyp in named))
    rows = []
    for shape in dict.fromkeys(polyp.shape for polyp in named):
        sizes = {p.pattern: f"{p.size / MM:.0f} mm" for p in named if p.shape == shape}
        rows.append([shape, *(sizes[pattern] for pattern in patterns)])
    return table(["", *patterns], rows)


def colitis() -> str:
    """Spread of the library's colitis by number."""
    named = [case for case in Colitis.library().values() if isinstance(case, Colitis)]
    ends = {c.variant: c.spread for c in named if c.mayo == 1 and not isinstance(c.spread, str)}
    return table(
        ["number", *(f"{number:02d}" for number in ends)],
        [["cm", *(f"{spread / CM:.0f}" for spread in ends.values())]],
    )


TABLES = {"kinds": kinds, "library": library, "polyps": polyps, "colitis": colitis}


def written(text: str) -> str:
    """The page with its tables made anew."""

    def fresh(found: re.Match[str]) -> str:
        return f"{found[1]}\n\n{TABLES[found[2]]()}\n\n{found[3]}"

    return re.sub(r"(<!-- table: (\w+) -->)\n.*?(<!-- end -->)", fresh, text, flags=re.DOTALL)


if __name__ == "__main__":
    PAGE.write_text(written(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
