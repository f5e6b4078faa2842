"""Claim: the masks of lesions are exact.

Puts each kind and grade of lesion into a generated organ, and looks at it from ten views, in every
second view at its border.

- *Mask*: `instance` of the renderer against Embree through the same rays, each hit taken back to
  the wall without lesions and measured there independently
  (`tests/organ/lesion/oracle_footprint.py`). Claimed: intersection over union ≥ 0.98 over the ten
  views.
- *Clean twin*: the same views without the lesion. Claimed: outside the mask depth and albedo are
  the same; light differs only by the lesion's shadow and the slope of the wall next to it.
- *Cuts*: pairs of triangles of the lesion that cut the wall. Claimed: none.

    python -m benchmarks.validation.lesions
"""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.common.scripts import options, table, write_section
from vrcaps.anatomy.catalog import generate_organ
from vrcaps.camera.camera import camera_rays
from vrcaps.capsule.device_file import read_device
from vrcaps.core.geometry import look_along, transform_from
from vrcaps.core.units import MM
from vrcaps.lesion import LesionPair, add_lesions, parse_lesion
from vrcaps.mesh.self_intersection import self_intersections
from vrcaps.organ.surface import OrganSurface, interpolate
from vrcaps.render.renderer import Renderer
from vrcaps.render.settings import RenderSettings
from vrcaps.world.model import Model, State

COLON = (
    "polyp-Ip:size=12mm", "polyp-Is", "polyp-IIa", "polyp-IIb", "polyp-IIc",
    "colitis-1:spread=6cm", "colitis-2:spread=6cm", "colitis-3:spread=6cm",
    "bleeding-1", "bleeding-2", "bleeding-3", "bleeding-4",
    "angioectasia", "lymphangiectasia", "erosion", "ulcer-aphthous:size=5mm", "ulcer-deep",
    "tumor", "diverticulum", "stricture",
)  # fmt: skip
CASES = {
    "colon": COLON,
    "small-bowel": ("angioectasia", "lymphangiectasia", "ulcer-aphthous:size=5mm", "polyp-Is"),
    "stomach": ("polyp-Is", "ulcer-deep:size=12mm", "bleeding-2"),
}
VIEWS = 10
CHANNELS = ("rgb", "depth", "albedo", "instance")
SAME_DEPTH = 20e-6
SAME_ALBEDO = 2.0 / 255.0
SAME_LEVEL = 2


def eyes(organ: OrganSurface, wall, target: np.ndarray, arc_length: float):
    """Positions in the lumen from which a target is visible, unordered, near ones first."""
    rng = np.random.default_rng(0)
    for _ in range(4000):
        at = np.clip(arc_length + rng.uniform(-40.0, 40.0) * MM, 0.0, organ.centerline.length)
        point, frame, radius = interpolate(organ.centerline, np.array([at]))
        eye = point[0] + frame[0, :, :2] @ (0.6 * radius[0] * rng.uniform(-1.0, 1.0, 2))
        apart = np.linalg.norm(target - eye)
        if not 8.0 * MM < apart < 45.0 * MM or wall.signed_distance(eye[None])[0] < 2.0 * MM:
            continue
        if wall.visible(tuple(eye), (eye + 0.99 * (target - eye))[None])[0]:
            yield eye


def poses(model: Model) -> list[np.ndarray]:
    """Ten cameras that look at points of the lesion, every second at its border."""
    organ, rng = model.organ, np.random.default_rng(1)
    own = organ.instance == 1
    on_border = np.zeros_like(own)
    on_border[organ.faces[own[organ.faces].any(axis=1) & ~own[organ.faces].all(axis=1)]] = True
    sides = [iter(rng.permutation(np.flatnonzero(side))) for side in (own, own & on_border)]
    found = []
    while (vertex := next(sides[len(found) % 2], None)) is not None:
        target = organ.vertices[vertex] + 0.2 * MM * organ.normals[vertex]
        eye = next(eyes(organ, model.wall, target, float(organ.arc_length[vertex])), None)
        if eye is not None:
            found.append(transform_from(look_along(target - eye, np.array([0.1, 0.2, 1.0])), eye))
        if len(found) == VIEWS:
            break
    return found


class Measured:
    """Sums over the views of one lesion."""

    def __init__(self) -> None:
        self.both = self.either = self.outside = 0
        self.depth = self.albedo = self.light = self.shadow = 0

    def add_mask(self, seen: np.ndarray, expected: np.ndarray) -> None:
        """Count the pixels of both masks."""
        self.both += int((seen & expected).sum())
        self.either += int((seen | expected).sum())

    def add_twin(self, lesioned, clean, shaded) -> None:
        """Count the pixels outside the mask that differ from the clean twin."""
        outside = (lesioned.instance == 0) & np.isfinite(lesioned.depth)
        self.outside += int(outside.sum())
        self.depth += int((outside & ~(np.abs(lesioned.depth - clean.depth) < SAME_DEPTH)).sum())
        albedo = np.abs(lesioned.albedo - clean.albedo).max(axis=-1)
        self.albedo += int((outside & (albedo > SAME_ALBEDO)).sum())
        for name, (one, two) in {"light": (lesioned, clean), "shadow": shaded}.items():
            apart = np.abs(one.rgb.astype(int) - two.rgb).max(axis=-1)
            setattr(self, name, getattr(self, name) + int((outside & (apart > SAME_LEVEL)).sum()))

    def row(self) -> tuple[str, ...]:
        """Columns of the table."""
        counts = (self.depth, self.albedo, self.light, self.shadow)
        overlap = self.both / max(self.either, 1)
        return (
            *(f"{self.either:,}", f"{overlap:.4f}", "yes" if overlap >= 0.98 else "**no**"),
            f"{self.outside:,}",
            *(f"{100.0 * n / self.outside:.3f} %" if self.outside else "–" for n in counts),
        )


def measure(organ: OrganSurface, text: str, step: int) -> tuple[str, ...]:
    """Row of one lesion."""
    from tests.support.oracle_embree import EmbreeCaster
    from tests.support.oracle_footprint import Footprint, Witness

    with Witness() as witness:
        patient = add_lesions(organ, [parse_lesion(text)], np.random.default_rng(0))
    footprint = Footprint(organ, patient.clean, witness)
    caster = EmbreeCaster(patient.organ.vertices, patient.organ.faces)
    device = read_device("mirocam")
    models = [Model(side, device, np.eye(4)) for side in (patient.organ, patient.clean)]
    plain, shaded = (
        [Renderer(model, RenderSettings(light="direct", shadows=on)) for model in models]
        for on in (False, True)
    )
    camera, measured = device.cameras[0], Measured()
    grid = np.mgrid[: camera.height : step, : camera.width : step]
    rows, columns = grid.reshape(2, -1)
    rays = camera_rays(camera)[rows, columns]
    for pose in poses(models[0]):
        state = State(0.0, pose @ np.linalg.inv(camera.T_capsule_camera))
        lesioned, clean = (side.render(state, camera, channels=CHANNELS) for side in plain)
        dark = tuple(side.render(state, camera, channels=("rgb",)) for side in shaded)
        measured.add_twin(lesioned, clean, dark)
        origins = np.broadcast_to(pose[:3, 3], rays.shape)
        _, face, weights = caster.cast(origins, rays @ pose[:3, :3].T)
        hit = face >= 0
        expected = np.zeros(len(rays), bool)
        corners = patient.clean.vertices[patient.clean.faces[face[hit]]]
        points = np.einsum("nk,nkx->nx", weights[hit], corners)
        expected[hit] = footprint.signed_distance(points) > 0.0
        measured.add_mask(lesioned.instance[rows, columns] == 1, expected & hit)
    return (*measured.row(), str(cuts(patient)))


def cuts(patient: LesionPair) -> int:
    """Intersecting pairs of triangles, one of them of the lesion."""
    organ = patient.organ
    own = organ.instance == 1
    corners = organ.vertices[organ.faces]
    of_own = corners[own[organ.faces].any(axis=1)]
    low, high = of_own.min(axis=(0, 1)), of_own.max(axis=(0, 1))
    near = ((corners.max(axis=1) >= low) & (corners.min(axis=1) <= high)).all(axis=1)
    faces = organ.faces[near]
    found = self_intersections(organ.vertices, faces)
    return int(own[faces].any(axis=1)[found].any(axis=1).sum())


def row(case: tuple[str, str], step: int) -> tuple[str, ...]:
    """Row of one case."""
    name, text = case
    organ = generate_organ(name, seed=0)
    return (name, text.replace(":", ", "), *measure(organ, text, step))


def main() -> None:
    """Measure two at a time, write the table as it grows."""
    given = options(__doc__ or "", size=2)
    cases = [(name, text) for name, texts in CASES.items() for text in texts]
    rows = []
    with ProcessPoolExecutor(2) as pool:
        for found in pool.map(partial(row, step=given.size), cases):
            rows.append(found)
            write_section(given.out, Path(__file__), section(rows, given.size))


def section(rows: list[tuple[str, ...]], step: int) -> str:
    """Table with its explanation."""
    head = (
        *("organ", "lesion", "pixels", "IoU", "≥ 0.98", "outside"),
        *("depth", "albedo", "light", "light and shadow", "cuts"),
    )
    return (
        "## Lesions\n\n`python -m benchmarks.validation.lesions`: each lesion from "
        f"{VIEWS} views by MiroCam, every second\nat its border. Masks "
        f"(every {step}nd ray of a row and column) against Embree and the footprint measured "
        "anew on the wall\nwithout lesions.\n\n"
        + table(head, rows)
        + "\n\n*Outside*: pixels outside the mask. *Depth*, *albedo*, *light*, *light and shadow*: "
        "fraction of them that differ from the\nclean twin by more than 20 µm, 2/255, two steps of "
        "255 without shadows, and the same with shadows. *Cuts*: pairs of\ntriangles of the "
        "lesion that intersect the wall or each other."
    )


if __name__ == "__main__":
    main()
