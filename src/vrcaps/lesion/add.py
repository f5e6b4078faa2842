"""Add lesions to an organ, and keep its clean twin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.core.errors import InputError
from vrcaps.core.geometry import wall_of
from vrcaps.core.rng import stream
from vrcaps.lesion import paint
from vrcaps.lesion.base import Form, Lesion
from vrcaps.lesion.mesh_patch import ExtractedPatch, as_organ, insert, whole_wall
from vrcaps.lesion.placement import PlacedLesion, describe, require_locations
from vrcaps.lesion.sites import SITES, PlacementContext, samples
from vrcaps.mesh.patch import Patch, ThinTrianglesError, refine, renewed_normals
from vrcaps.mesh.self_intersection import self_intersections
from vrcaps.organ.surface import OrganSurface

if TYPE_CHECKING:
    from jaxtyping import Float

_DOWN = (0.0, 1.0, 0.0)  # patient frame (LPS) of a supine patient
_MAX_LESIONS = 65_535
_NUM_TRIES = 12


@dataclass(frozen=True)
class LesionPair:
    """Organ with lesions and its clean twin.

    Both have the same faces, texture coordinates and gut coordinates; vertices and texels
    differ only in the footprints of lesions.

    Attributes:
        organ: Organ with lesions; `instance` numbers them from 1, `metadata["lesions"]` lists them.
        clean: The clean twin; `instance` is 0.
    """

    organ: OrganSurface
    clean: OrganSurface


def add_lesions(
    organ: OrganSurface,
    lesions: Sequence[Lesion],
    rng: np.random.Generator,
    *,
    down: Sequence[float] | Float[np.ndarray, " 3"] = _DOWN,
) -> LesionPair:
    """Place, shape and paint lesions on an organ's wall.

    Each focal lesion is checked to fit first. Circumferential lesions are placed first,
    then focal ones, so that a polyp may lie in colitis; focal lesions do not overlap.

    Args:
        organ: Organ without lesions. Its appearance, if any, is painted.
        lesions: Lesions to add; lesion k becomes instance k, counted from 1.
        rng: Draws unspecified locations and all irregularity.
        down: Direction of gravity in the patient frame, for blood; supine by default.

    Raises:
        InputError: If a lesion does not fit anywhere or a location is not on the wall.
        UnknownNameError: If the organ has no such segment.
    """
    if len(lesions) > _MAX_LESIONS:
        raise InputError(f"{len(lesions)} lesions. Allowed: up to {_MAX_LESIONS}.")
    rngs = [
        stream(int(seed.integers(2**31)), "lesions/shape", lesion.variant)
        for seed, lesion in zip(rng.spawn(len(lesions)), lesions, strict=True)
    ]
    require_locations(organ, wall_of(organ.vertices, organ.faces), lesions, rngs)
    work = _Work(organ, np.asarray(down, float) / np.linalg.norm(down))
    order = {"circumferential": 0, "flow": 1, "focal": 2}
    for index in sorted(range(len(lesions)), key=lambda k: order[lesions[k].extent]):
        work.add(lesions[index], index + 1, rngs[index])
    return work.finished()


def lesion_rng(seed: int) -> np.random.Generator:
    """Random generator of a patient's lesions, for `add_lesions`."""
    return stream(seed, "lesions")


class _Work:
    """Wall and textures during the addition of lesions."""

    def __init__(self, organ: OrganSurface, down: Float[np.ndarray, " 3"]) -> None:
        self.organ = organ
        self.down = down
        self.wall = whole_wall(organ)
        self.num_vertices = len(organ.vertices)
        look = organ.appearance
        textures = None if look is None else paint.smoothed(look)
        self.clean = self.lesioned = textures
        self.charts: list[paint.Chart] = []
        self.focal: list[PlacedLesion] = []
        self.records: dict[int, dict[str, Any]] = {}

    def add(self, lesion: Lesion, instance: int, rng: np.random.Generator) -> None:
        """Add one lesion; retry at another location or in another form if the wall self-intersects.

        Args:
            lesion: Lesion to add.
            instance: Instance ID.
            rng: Draws its location and irregularities.

        Raises:
            InputError: If it does not fit anywhere.
        """
        organ = as_organ(self.wall, self.organ, self.wall.moved)
        context = PlacementContext(organ, self.wall, self.down, self.num_vertices, self.focal)
        reason = f"in {_NUM_TRIES} tries it cuts into the adjacent wall"
        for _ in range(_NUM_TRIES):
            try:
                placed = SITES[lesion.extent](lesion, context, rng)
            except ThinTrianglesError as error:
                reason = str(error)
                continue
            form = lesion.form(placed.site, rng)
            patch = _formed(placed.patch, form, is_focal=lesion.extent == "focal")
            wall = samples(patch)
            form_samples = paint.FormSamples(form, wall, form.displaced(wall) - placed.site.center)
            if lesion.extent == "focal":
                patch = _charted(patch, form_samples, instance)
            joined = _with_lesion(self.wall, placed.piece, patch, form_samples, instance)
            if not _cuts_wall(joined, instance):
                break
        else:
            raise InputError(
                f"No location for {describe(lesion)}: {reason}. Choose another location or a "
                "smaller one."
            )
        if self.clean is not None and self.lesioned is not None:
            self._paint(lesion, instance, patch, form_samples)
        if lesion.extent == "focal":
            self.focal.append(PlacedLesion(lesion, placed.vertex, placed.site.center))
        self.wall = joined
        self._record(lesion, instance, organ, placed.vertex)

    def _paint(
        self, lesion: Lesion, instance: int, patch: Patch, form_samples: paint.FormSamples
    ) -> None:
        """Paint on a separate chart, or in place."""
        assert self.clean is not None and self.lesioned is not None
        if lesion.extent == "focal":
            self.charts.append(
                paint.paint_chart(self.clean, self.lesioned, patch, form_samples, instance)
            )
            return
        inside = form_samples.form.signed_distance(form_samples.wall) > 0.0
        faces = np.flatnonzero(inside[patch.faces].any(axis=1))
        if len(faces):
            if self.lesioned is self.clean:
                self.lesioned = self.clean.copy()
            paint.paint_in_place(self.lesioned, patch, form_samples, faces)

    def _record(self, lesion: Lesion, instance: int, organ: OrganSurface, vertex: int) -> None:
        self.records[instance] = {
            "instance": instance,
            "kind": lesion.kind,
            "grade": lesion.grade,
            "segment": organ.label_names[organ.label[vertex]],
            "arc_length_m": float(organ.arc_length[vertex]),
            "theta_rad": float(organ.theta[vertex]),
            "center_m": organ.vertices[vertex].tolist(),
            "specification": {"kind": lesion.kind, **asdict(lesion)},
        }

    def finished(self) -> LesionPair:
        """Both organs, with textures enlarged by the charts."""
        records = [self.records[k] for k in sorted(self.records)]
        lesioned = as_organ(self.wall, self.organ, self.wall.moved)
        clean = as_organ(self.wall, self.organ, self.wall.clean)
        clean = replace(clean, instance=np.zeros_like(clean.instance))
        metadata = self.organ.metadata
        lesioned = replace(lesioned, metadata={**metadata, "lesions": records})
        clean = replace(clean, metadata={**metadata, "lesions": [], "clean_twin_of": records})
        if self.clean is None or self.lesioned is None:
            return LesionPair(lesioned, clean)
        base = self.clean.appearance
        atlas = paint.pack(base, self.wall.uv[..., :2], self.charts)
        uv = paint.final_uv(self.wall, base, self.charts, atlas)
        return LesionPair(
            replace(
                lesioned,
                uv=uv,
                appearance=paint.assemble(
                    self.lesioned.appearance, self.charts, atlas, lesioned=True
                ),
            ),
            replace(
                clean,
                uv=uv,
                appearance=paint.assemble(base, self.charts, atlas, lesioned=False),
            ),
        )


def _formed(patch: Patch, form: Form, *, is_focal: bool) -> Patch:
    """Patch refined until its triangles resolve a form and its border."""

    def is_long(patch: Patch, ends: np.ndarray) -> np.ndarray:
        wall = samples(patch)
        inside = (form.signed_distance(wall) > 0.0)[ends]
        points = form.displaced(wall)
        length = np.linalg.norm(points[ends[:, 0]] - points[ends[:, 1]], axis=1)
        border = inside[:, 0] != inside[:, 1]
        return (inside.any(axis=1) & (length > form.edge_length)) | (
            border & (length > form.border_length)
        )

    def both(patch: Patch) -> np.ndarray:
        return np.hstack([form.displaced(samples(patch)), patch.moved])

    return refine(patch, is_long, both if is_focal else lambda patch: patch.moved)


def _with_lesion(
    wall: Patch, piece: ExtractedPatch, patch: Patch, form_samples: paint.FormSamples, instance: int
) -> Patch:
    """Wall with the patch inserted and its vertices displaced."""
    inside = form_samples.form.signed_distance(form_samples.wall) > 0.0
    label = np.where(inside, instance, patch.instance).astype(np.uint16)
    moved = form_samples.form.displaced(form_samples.wall)
    return insert(wall, piece, renewed_normals(replace(patch, moved=moved, instance=label)))


def _cuts_wall(wall: Patch, instance: int) -> bool:
    """Return whether a lesion caused a self-intersection of the wall."""
    own = (wall.instance == instance) & (wall.moved != wall.clean).any(axis=1)
    if not own.any():
        return False
    corners = wall.moved[wall.faces]
    of_own = corners[own[wall.faces].any(axis=1)]
    low, high = of_own.min(axis=(0, 1)), of_own.max(axis=(0, 1))
    near = ((corners.max(axis=1) >= low) & (corners.min(axis=1) <= high)).all(axis=1)
    faces = wall.faces[near]
    is_own = own[faces].any(axis=1)
    placed = self_intersections(wall.moved, faces)
    if not is_own[placed].any():
        return False
    before = self_intersections(wall.clean, faces)
    return is_own[placed].any(axis=1).sum() > is_own[before].any(axis=1).sum()


def _charted(patch: Patch, form_samples: paint.FormSamples, instance: int) -> Patch:
    """Patch with the footprint's faces on a separate chart."""
    own = (form_samples.form.signed_distance(form_samples.wall) > 0.0)[patch.faces].any(axis=1)
    uv = patch.uv.copy()
    uv[own, :, 2:] = form_samples.form.chart(form_samples.wall)[patch.faces[own]]
    return replace(patch, uv=uv, chart_id=np.where(own, instance, patch.chart_id))
