"""`vrcaps organ list`: the organs, lesions, mucosae and capsules that go by name."""

from __future__ import annotations

from dataclasses import dataclass

from vrcaps.cli.console import console


@dataclass(frozen=True)
class List:
    """List the built-in organs and all that goes with them, and what to type next.

    For example:
      vrcaps organ list
    """

    def run(self) -> None:
        """Print the tables."""
        from vrcaps.capsule.catalog import device_names, load_device
        from vrcaps.organ.appearance import MUCOSAE
        from vrcaps.organ.catalog import CONDITIONS, ORGANS, organ_segments
        from vrcaps.organ.lesion import LIBRARY

        usual = "colon inflated, all else normal"
        _print("organs", [(name, _words(organ_segments(name))) for name in ORGANS])
        _print("fillings", [("--condition", f"{', '.join(CONDITIONS)}; by default {usual}")])
        _print("lesions, in any of them", _lesions())
        _print("", [("by name", f"{len(LIBRARY)} of a library, such as {_examples(LIBRARY)}")])
        photos = "or the folder of a texture from your photographs (vrcaps organ texture)"
        _print("mucosae", [("--mucosa", f"{', '.join(MUCOSAE)}; {photos}")])
        devices = [load_device(name) for name in device_names()]
        _print("capsules", [(device.name, device.title) for device in devices])
        console.print("Next:")
        for line in (
            "vrcaps organ make stomach --seed 3                 write one as GLB, with a picture",
            "vrcaps organ inspect gi --seed 3                   only the picture",
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

    from vrcaps.organ.lesion import LESIONS

    rows = []
    for kind, cls in LESIONS.items():
        grade = cls.grade_field
        grades = get_args(get_type_hints(cls)[grade]) if grade else ()
        name = f"{kind}-{'|'.join(map(str, grades))}" if grades else kind
        # Inherited settings come first; what is a kind's own matters more.
        settings = [f.name for f in reversed(fields(cls)) if f.name not in ("place", grade)]
        rows.append((name, _words(tuple(settings))))
    return [*rows, ("place of each", "segment, arc_length, theta; drawn where left out")]


def _examples(library: dict) -> str:
    names = list(library)
    return ", ".join((names[0], names[len(names) // 2], names[-1]))
