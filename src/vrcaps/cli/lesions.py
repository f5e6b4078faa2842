"""Lesions in the output of the command line."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from vrcaps.core.units import CM, MM


def lesion_lines(records: Sequence[dict[str, Any]], length: float) -> list[str]:
    """One line per lesion of an organ.

    Args:
        records: Lesions of `OrganSurface.metadata` or `episode.json`.
        length: Length of the centerline [m].
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
