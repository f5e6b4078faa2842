"""`vrcaps organ list`: the organs, lesions, mucosae and capsules of the catalog."""

from __future__ import annotations

from dataclasses import dataclass

from vrcaps.cli.console import console


@dataclass(frozen=True)
class List:
    """List the built-in organs, lesions, mucosae, effects and capsules, and next commands.

    For example:
      vrcaps organ list
    """

    def run(self) -> None:
        """Print the tables."""
        from vrcaps.anatomy.catalog import DISTENSIONS, ORGANS, organ_segments
        from vrcaps.camera_pipeline.effects import EFFECTS
        from vrcaps.capsule.device_file import device_names, read_device
        from vrcaps.lesion import lesion_library
        from vrcaps.mucosa.mucosa import MUCOSAE

        usual = "colon inflated, all else normal"
        _print("organs", [(name, _words(organ_segments(name))) for name in ORGANS])
        _print("distension", [("--distension", f"{', '.join(DISTENSIONS)}; by default {usual}")])
        _print("lesions, in any organ", _lesions())
        _print(f"library of {len(lesion_library())} lesions by name", _library())
        photos = "or the folder of a texture from your photographs (vrcaps organ texture)"
        _print("mucosae", [("--mucosa", f"{', '.join(MUCOSAE)}; {photos}")])
        devices = [read_device(name) for name in device_names()]
        _print("capsules", [(device.name, device.title) for device in devices])
        _print("camera effects", [(name, kind.summary()) for name, kind in EFFECTS.items()])
        console.print("Next:")
        for line in (
            "vrcaps organ make stomach --seed 3                 write one as GLB, with a picture",
            "vrcaps organ inspect full-tract --seed 3           only the picture",
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
    """Each kind with its grades in the form of `--lesion`, and its settings."""
    from vrcaps.lesion import LESIONS
    from vrcaps.lesion.base import settings_of
    from vrcaps.lesion.library import describe_kind

    rows = []
    for kind, cls in LESIONS.items():
        grades = settings_of(cls)[cls.grade_field].words if cls.grade_field else ()
        name = f"{kind}-{'|'.join(map(str, grades))}" if grades else kind
        rows.append((name, describe_kind(cls)[1].replace("`", "")))
    return [
        *rows,
        ("location of each", "segment, arc_length, theta; drawn where left out"),
        ("variant of each", "a whole number: another lesion of the same specification"),
    ]


def _library() -> list[tuple[str, str]]:
    """Names of the library by kind: their count, first and last."""
    from vrcaps.lesion import LESIONS

    libraries = {kind: list(cls.library()) for kind, cls in LESIONS.items()}
    return [
        (f"{len(names)} {kind}", f"{names[0]} to {names[-1]}")
        for kind, names in libraries.items()
        if names
    ]
