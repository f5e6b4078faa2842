"""Lesions as the command line names them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import vrcaps.rng
from vrcaps.errors import InputError
from vrcaps.units import CM, MM

if TYPE_CHECKING:
    from vrcaps.lesion import Lesion


def chosen_lesions(
    texts: Sequence[str], source: str | None, seed: int, organ: str
) -> tuple[Lesion, ...]:
    """Lesions of a file or of the prevalence table, then those given one by one.

    Args:
        texts: Each as `parse_lesion` reads it.
        source: Path of a file, ``prevalence``, or None.
        seed: The patient's, for the table.
        organ: Name or file that they go into; the table is of the colon.

    Raises:
        InputError: If a text or the file cannot be read, or the table is of another organ.
        UnknownNameError: If a lesion or a key is unknown.
    """
    from vrcaps.anatomy.catalog import ORGANS, organ_segments
    from vrcaps.lesion import draw_lesions, parse_lesion
    from vrcaps.scenario.scenario import read_lesions

    if source == "prevalence":
        colons = [name for name in ORGANS if "sigmoid" in organ_segments(name)]
        if organ in ORGANS and organ not in colons:
            raise InputError(
                f"--lesions prevalence is a table of the colon, but the organ is {organ}. Allowed "
                f"with it: {', '.join(colons)}. Give single ones with --lesion, or your own as a "
                "file."
            )
        first: tuple[Lesion, ...] = draw_lesions(None, vrcaps.rng.stream(seed, "lesions/drawn"))
    else:
        first = () if source is None else read_lesions(Path(source))
    return (*first, *(parse_lesion(text) for text in texts))


def lesion_lines(records: Sequence[dict[str, Any]], length: float) -> list[str]:
    """One line for each lesion of an organ.

    Args:
        records: Of `OrganSurface.metadata` or `episode.json`.
        length: Of the centerline [m].
    """
    lines = []
    for record in records:
        fraction = record["arc_length_m"] / length
        size = record["specification"].get("size")
        words = [record["kind"], record["grade"], f"of {size / MM:.1f} mm" if size else ""]
        lines.append(
            f"{record['instance']}: {' '.join(word for word in words if word)}, "
            f"{record['segment']}, {record['arc_length_m'] / CM:.1f} cm "
            f"({fraction:.3f} of the centerline)"
        )
    return lines
