"""Organ of a scenario: generated, from a file or in memory, with its appearance and lesions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from vrcaps.config.convert import to_plain
from vrcaps.config.file_ref import FileRef, path_of, with_checksums
from vrcaps.core.errors import InputError
from vrcaps.core.rng import stream
from vrcaps.core.units import LENGTH_UNITS
from vrcaps.lesion import (
    Lesion,
    add_lesions,
    draw_lesions,
    lesion_rng,
    parse_lesion,
)
from vrcaps.lesion.placement import require_possible
from vrcaps.organ.organ_file import is_organ_file
from vrcaps.organ.surface import OrganSurface
from vrcaps.scenario.scenario import OrganFile, OrganGenerated, read_lesions
from vrcaps.world.model import posture_transform

PREVALENCE = "prevalence"
"""Source that replaces a file of lesions: a random number of them, as in screening patients."""

Organ = OrganGenerated | OrganFile | OrganSurface
"""Generator, file, or organ in memory."""


@dataclass(frozen=True)
class OrganSource:
    """Organ of a resolved scenario: its generator or file, and the lesions to add.

    Attributes:
        given: Generator, file, or organ in memory.
        lesions: Lesions to add.
        posture: Posture of the patient: some lesions lie at the lowest point.
        seed: Seed of the mucosa of an organ that has none, and of lesions in it.
    """

    given: Organ
    lesions: tuple[Lesion, ...] = ()
    posture: str = "supine"
    seed: int = 0

    def load(self, *, clean: bool = False) -> OrganSurface:
        """Organ with its lesions, or its clean twin without them.

        An organ with lesions is generated once and then read from the user's cache folder.

        Raises:
            InputError: If the organ cannot be generated or read, or a lesion does not fit in it.
        """
        from vrcaps.organ.cache import cached_organ, fingerprint

        if not self.lesions:
            return self._require_clean(self.load_healthy()) if clean else self.load_healthy()
        if isinstance(self.given, OrganGenerated):  # check before minutes of work
            require_possible(self.lesions, _max_diameter(self.given))
        if isinstance(self.given, OrganSurface):
            return self._with_lesions(clean=clean)
        key = {
            "lesions": to_plain(self.lesions, tuple[Lesion, ...]),
            "organ": asdict(self.given),
            "down": self._down.tolist(),
            "seed": self._lesion_seed,
            "clean": clean,
        }
        return cached_organ(f"lesions-{fingerprint(key)}", lambda: self._with_lesions(clean=clean))

    def load_healthy(self) -> OrganSurface:
        """Organ with its appearance, without the lesions to add.

        It is generated once and then read from the user's cache folder.
        """
        from vrcaps.anatomy.catalog import generate_organ
        from vrcaps.organ.cache import cached_organ, fingerprint

        given = self.given
        if isinstance(given, OrganGenerated):
            return generate_organ(
                given.name, seed=given.seed, distension=given.distension, mucosa=_mucosa(given)
            )
        if isinstance(given, OrganSurface):
            return given if given.appearance is not None else self._with_appearance(given)
        path = path_of(given.path)
        if is_organ_file(path) and (organ := _read_file(given)).appearance is not None:
            if given.mucosa is not None:
                raise InputError(f"{path} has its own textures. Leave out the mucosa.")
            return organ
        key = fingerprint(asdict(given) | {"seed": self.seed})
        return cached_organ(f"file-{key}", lambda: self._with_appearance(_read_file(given)))

    def _with_appearance(self, organ: OrganSurface) -> OrganSurface:
        from vrcaps.mucosa.bake import bake_appearance
        from vrcaps.mucosa.mucosa import own_mucosa

        mucosa = None if isinstance(self.given, OrganSurface) else _mucosa(self.given)
        look = bake_appearance(organ, seed=self.seed, mucosa=mucosa or own_mucosa(organ))
        return replace(organ, appearance=look)

    def _with_lesions(self, *, clean: bool) -> OrganSurface:
        """Organ with the lesions, or the same organ before they are added."""
        rng, organ = lesion_rng(self._lesion_seed), self.load_healthy()
        if organ.metadata.get("lesions"):
            raise InputError(f"{organ.name} has lesions already. Give none, or its clean twin.")
        patient = add_lesions(organ, self.lesions, rng, down=self._down)
        return patient.clean if clean else patient.organ

    @property
    def _lesion_seed(self) -> int:
        return getattr(self.given, "seed", self.seed)

    @property
    def _down(self) -> np.ndarray:
        """Direction of gravity in the patient frame."""
        return posture_transform(self.posture)[:3, :3].T @ np.array([0.0, 0.0, -1.0])

    @staticmethod
    def _require_clean(organ: OrganSurface) -> OrganSurface:
        if organ.metadata.get("lesions"):
            raise InputError(
                f"{organ.name} contains its lesions permanently, so it has no clean twin. Give the "
                "file of the clean twin, which `vrcaps organ make --clean-twin` writes."
            )
        return organ


def resolve_organ(organ: Organ) -> Organ:
    """Fill in the unit and the checksums of an organ's files.

    Raises:
        InputError: If a file does not match its checksum, or a mesh file has no unit.
    """
    if isinstance(organ, OrganSurface):
        return organ
    if isinstance(organ, OrganFile) and not organ.unit:
        if not is_organ_file(path_of(organ.path)):
            raise InputError(
                f"unit is missing: {path_of(organ.path)} does not state its unit. Allowed: "
                f"{', '.join(LENGTH_UNITS)}, or e.g. 5cm."
            )
        organ = replace(organ, unit="m")
    return with_checksums(organ)


def parse_lesions(
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

    if source == PREVALENCE:
        colons = [name for name in ORGANS if "sigmoid" in organ_segments(name)]
        if organ in ORGANS and organ not in colons:
            raise InputError(
                f"prevalence is a table of the colon, but the organ is {organ}. Allowed with it: "
                f"{', '.join(colons)}. Give single lesions, or a file of your own."
            )
        first: tuple[Lesion, ...] = draw_lesions(None, stream(seed, "lesions/drawn"))
    else:
        first = () if source is None else read_lesions(Path(source))
    return (*first, *(parse_lesion(text) for text in texts))


def _mucosa(organ: OrganGenerated | OrganFile) -> str | None:
    """Name of a mucosa or path of its texture."""
    return organ.mucosa.path if isinstance(organ.mucosa, FileRef) else organ.mucosa


def _max_diameter(organ: OrganGenerated) -> float:
    from vrcaps.anatomy.full_tract.patient import draw_patient_anatomy, widest_diameter

    return widest_diameter(draw_patient_anatomy(organ.seed, organ.distension), organ.name)


def _read_file(organ: OrganFile) -> OrganSurface:
    from vrcaps.organ.read_organ import read_organ

    return read_organ(
        path_of(organ.path),
        unit=organ.unit,
        open_ends=organ.open_ends,
        keep_uv=organ.keep_uv,
        reverse=organ.reverse,
    )
