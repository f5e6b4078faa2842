"""`vrcaps organ list`: the organs, lesions, mucosae and capsules that go by name."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from vrcaps.cli.console import console
from vrcaps.units import MM

if TYPE_CHECKING:
    from vrcaps.lesion import Lesion


@dataclass(frozen=True)
class List:
    """List the built-in organs and all that goes with them, and what to type next.

    For example:
      vrcaps organ list
    """

    def run(self) -> None:
        """Print the tables."""
        from vrcaps.anatomy.catalog import DISTENSIONS, ORGANS, organ_segments
        from vrcaps.capsule.catalog import device_names, read_device
        from vrcaps.lesion import LIBRARY
        from vrcaps.mucosa.appearance import MUCOSAE

        usual = "colon inflated, all else normal"
        _print("organs", [(name, _words(organ_segments(name))) for name in ORGANS])
        _print("fillings", [("--distension", f"{', '.join(DISTENSIONS)}; by default {usual}")])
        _print("lesions, in any of them", _lesions())
        _print(f"library of {len(LIBRARY)} lesions by name", _library())
        photos = "or the folder of a texture from your photographs (vrcaps organ texture)"
        _print("mucosae", [("--mucosa", f"{', '.join(MUCOSAE)}; {photos}")])
        devices = [read_device(name) for name in device_names()]
        _print("capsules", [(device.name, device.title) for device in devices])
        console.print("Next:")
        for line in (
            "vrcaps organ make stomach --seed 3                 write one as GLB, with a picture",
            "vrcaps organ inspect full-tract --seed 3                   only the picture",
            "vrcaps organ make colon --lesion polyp-Ip:size=12mm,segment=sigmoid",
            "vrcaps record --organ colon-0.glb --out runs/mine  record in the file written",
            "vrcaps record --organ stomach --out runs/stomach   record in a generated one",
        ):
            console.print(f"  {line}")


def _print(title: str, rows: list[tuple[str, str]]) -> None:
    from rich.table import Table

    if title:
        console.print(title.upper())
    table = Table(show_header=False, box=None, padding=(0, 2, 0, 2))
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for row in rows:
        table.add_row(*row)
    console.print(table)
    console.print()


def _words(names: tuple[str, ...]) -> str:
    return ", ".join(names)


def _lesions() -> list[tuple[str, str]]:
    """Each kind with its grades as `--lesion` takes them, and the settings it has."""
    from dataclasses import fields
    from typing import get_args, get_type_hints

    from vrcaps.lesion import LESIONS

    rows = []
    for kind, cls in LESIONS.items():
        grade = cls.grade_field
        grades = get_args(get_type_hints(cls)[grade]) if grade else ()
        name = f"{kind}-{'|'.join(map(str, grades))}" if grades else kind
        # Inherited settings come first; what is a kind's own matters more.
        settings = [f.name for f in reversed(fields(cls)) if f.name not in ("location", grade)]
        rows.append((name, "; ".join(_setting(cls, key) for key in settings)))
    return [*rows, ("place of each", "segment, arc_length, theta; drawn where left out")]


def _setting(cls: type[Lesion], key: str) -> str:
    """A setting with what it may be, where that is a list of words or a range of sizes."""
    from typing import Literal, get_args, get_origin, get_type_hints

    hint = get_type_hints(cls)[key]
    parts = [part for part in (hint, *get_args(hint)) if get_origin(part) is Literal]
    words = [str(word) for part in parts for word in get_args(part)]
    sizes = getattr(cls, "sizes", None) if key == "size" else None
    if sizes is not None:
        return f"size {sizes[0] / MM:g} to {sizes[1] / MM:g} mm"
    if float in get_args(hint):
        words.append("a length")
    return f"{key} {', '.join(words)}" if words else key


def _library() -> list[tuple[str, str]]:
    """The library's names by kind: as many as there are, from first to last."""
    from vrcaps.lesion import LIBRARY

    names: dict[str, list[str]] = {}
    for name in LIBRARY:
        names.setdefault(name.partition("-")[0], []).append(name)
    return [(f"{len(own)} {kind}", f"{own[0]} to {own[-1]}") for kind, own in names.items()]
