"""Lesions chosen by the user: short texts, a file or the prevalence table."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from vrcaps.core.errors import InputError
from vrcaps.core.rng import stream

if TYPE_CHECKING:
    from vrcaps.lesion import Lesion

PREVALENCE = "prevalence"
"""Source that replaces a file: a random number of lesions, as in screening patients."""


def chosen_lesions(
    texts: Sequence[str], source: str | None, seed: int, organ: str
) -> tuple[Lesion, ...]:
    """Lesions of a file or of the prevalence table, followed by those given individually.

    Args:
        texts: Lesions in the syntax of `parse_lesion`.
        source: Path of a file, ``prevalence``, or None.
        seed: Seed of the patient, for the table.
        organ: Name or file of the organ that receives them; the table is for the colon.

    Raises:
        InputError: If a text or the file cannot be read, or the table is for another organ.
        UnknownNameError: If a lesion or a key is unknown.
    """
    from vrcaps.anatomy.catalog import ORGANS, organ_segments
    from vrcaps.lesion import draw_lesions, parse_lesion
    from vrcaps.scenario.scenario import read_lesions

    if source == PREVALENCE:
        colons = [name for name in ORGANS if "sigmoid" in organ_segments(name)]
        if organ in ORGANS and organ not in colons:
            raise InputError(
                f"prevalence is a table of the colon, but the organ is {organ}. Allowed with it: "
                f"{', '.join(colons)}. Give single lesions, or your own as a file."
            )
        first: tuple[Lesion, ...] = draw_lesions(None, stream(seed, "lesions/drawn"))
    else:
        first = () if source is None else read_lesions(Path(source))
    return (*first, *(parse_lesion(text) for text in texts))
