"""Chosen lesions: as a user names them, by short texts, a file or the prevalence table."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import vrcaps.rng
from vrcaps.errors import InputError

if TYPE_CHECKING:
    from vrcaps.lesion import Lesion

PREVALENCE = "prevalence"
"""In place of a file: as many lesions as a screening patient has."""


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

    if source == PREVALENCE:
        colons = [name for name in ORGANS if "sigmoid" in organ_segments(name)]
        if organ in ORGANS and organ not in colons:
            raise InputError(
                f"prevalence is a table of the colon, but the organ is {organ}. Allowed with it: "
                f"{', '.join(colons)}. Give single lesions, or your own as a file."
            )
        first: tuple[Lesion, ...] = draw_lesions(None, vrcaps.rng.stream(seed, "lesions/drawn"))
    else:
        first = () if source is None else read_lesions(Path(source))
    return (*first, *(parse_lesion(text) for text in texts))
