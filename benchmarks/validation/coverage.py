"""Claim: `visible` agrees with brute force within 1 % of an organ's area.

Brute force: points spread over every triangle are looked at from every pose; a triangle is seen if
a point of it is in the image and Embree's ray to it meets nothing before it. A capsule flies
through each organ; all pixels of its camera count. Closed forms: a camera in the center of a sphere
sees a cap; on the axis of a cylinder it resolves a band from the rim of its field to the largest
incidence.

    python -m benchmarks.validation.coverage [--size POSES]
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import trimesh

from benchmarks.common.scripts import DATA, options, table, write_section
from vrcaps.anatomy.catalog import generate_organ
from vrcaps.camera.camera import Camera, in_image, project_points
from vrcaps.camera.lens import LensEquidistant
from vrcaps.capsule.device_file import read_device
from vrcaps.core.geometry import invert, transform_points, triangle_areas, wall_of
from vrcaps.metrics.coverage import CoverageCriteria, vertices_in_frustum
from vrcaps.metrics.view_coverage import ViewCoverage, coverable
from vrcaps.organ.read_organ import read_organ
from vrcaps.organ.surface import OrganSurface
from vrcaps.world.model import Model

# isort: split
from tests.support.oracle_embree import EmbreeCaster
from tests.support.tubes import straight_tube

POINTS = 32
"""On each triangle."""

SLACK = 2e-5
"""A ray ends so far before its point [m]: single precision of the oracle's rays."""

HEAD = (
    "organ", "triangles", "poses", "visible", "brute force", "difference", "claimed", "resolved",
    "frustum", "coverable",
)  # fmt: skip
HALF_FIELD = math.radians(60.0)


def organs() -> list[OrganSurface]:
    """Two generated organs, and one from CT if present."""
    made = [generate_organ("colon", seed=21), generate_organ("stomach", seed=21)]
    path = DATA / "stomach_A_mm.ply"
    return made + ([read_organ(path, unit="mm")] if path.exists() else [])


def points_on(corners: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Points [m k 3] on triangles: the centroid, and random ones."""
    u = rng.random((len(corners), POINTS, 2))
    u = np.where(u.sum(axis=-1, keepdims=True) > 1.0, 1.0 - u, u)
    u[:, 0] = 1.0 / 3.0
    weights = np.concatenate([1.0 - u.sum(axis=-1, keepdims=True), u], axis=-1)
    return np.einsum("mkc,mcx->mkx", weights, corners)


def brute_force(model: Model, camera: Camera, poses: np.ndarray) -> np.ndarray:
    """Triangles with a point visible from a pose."""
    organ = model.organ
    vertices = transform_points(model.T_world_patient, organ.vertices)
    caster = EmbreeCaster(vertices, organ.faces)
    points = points_on(vertices[organ.faces], np.random.default_rng(0))
    seen = np.zeros(len(points), bool)
    for pose in poses:
        left = np.flatnonzero(~seen)
        at = points[left].reshape(-1, 3)
        pixels = project_points(camera, transform_points(invert(pose), at))
        number = np.flatnonzero(in_image(camera, pixels))
        way = at[number] - pose[:3, 3]
        length = np.linalg.norm(way, axis=1)
        found, face, _ = caster.cast(np.tile(pose[:3, 3], (len(number), 1)), way / length[:, None])
        free = (face == left[number // POINTS]) | (found > length - SLACK)
        seen[left[np.unique(number[free] // POINTS)]] = True
    return seen


def measure(organ: OrganSurface, count: int) -> tuple[str, ...]:
    """A row of the table."""
    device = read_device("mirocam")
    model, camera = Model(organ, device), device.cameras[0]
    along = np.linspace(0.03, 0.97, count) * organ.centerline.length
    poses = model.centerline_poses(along) @ camera.T_capsule_camera
    views = ViewCoverage(camera)
    flags = views.seen([model.wall], poses, len(organ.faces))
    true = brute_force(model, camera, poses)
    area = triangle_areas(organ.vertices[organ.faces])
    area /= area.sum()
    near = np.zeros(len(organ.vertices), bool)
    vertices = transform_points(model.T_world_patient, organ.vertices)
    for pose in poses:
        near |= vertices_in_frustum(camera, pose, vertices, CoverageCriteria().max_depth)
    differs = float(area[flags["visible"] != true].sum())
    able = coverable(model)
    shares = (area[flags["visible"]].sum(), area[true].sum(), differs)
    return (
        organ.name,
        f"{len(organ.faces):,}",
        str(count),
        *(f"{100.0 * share:.2f} %" for share in shares),
        f"≤ 1 %: {'yes' if differs <= 0.01 else 'NO'}",
        f"{100.0 * area[flags['resolved']].sum():.1f} %",
        f"{100.0 * near.mean():.1f} %",
        f"{100.0 * area[able['visible']].sum():.1f} %",
    )


def camera_of(size: int) -> Camera:
    """A fisheye camera of 120° whose field fits into the image."""
    center, focal = (size - 1) / 2.0, 0.48 * size / HALF_FIELD
    lens = LensEquidistant(focal=focal, cx=center, cy=center, max_angle=HALF_FIELD)
    return Camera("front", lens, size, size, exposure=1.0)


def closed_forms() -> list[tuple[str, ...]]:
    """Rows of the sphere and the cylinder."""
    sphere = trimesh.creation.icosphere(subdivisions=7, radius=0.03)
    views = ViewCoverage(camera_of(1200))
    pose = np.eye(4)[None]
    wall = wall_of(np.array(sphere.vertices), np.array(sphere.faces))
    seen = views.seen([wall], pose, len(sphere.faces))["visible"]
    cap = (1.0 - math.cos(HALF_FIELD)) / 2.0
    rows = [("sphere, 120° from its center", sphere.area_faces[seen].sum() / sphere.area, cap)]
    radius, most = 0.02, math.radians(70.0)
    tube = straight_tube(0.3, radius, 128, 751)
    vertices, faces = tube.vertices, tube.faces
    area = triangle_areas(vertices[faces])
    criteria = CoverageCriteria(min_pixel_density=0.0, max_incidence=most)
    found = ViewCoverage(camera_of(1200), criteria).seen(
        [wall_of(vertices, faces)], pose, len(faces)
    )
    band = 2.0 * math.pi * radius**2 * (math.tan(most) - 1.0 / math.tan(HALF_FIELD))
    rows.append(
        (
            "cylinder, 120° on its axis, incidence ≤ 70°",
            area[found["resolved"]].sum() / area.sum(),
            band / area.sum(),
        )
    )
    return [
        (name, f"{100 * a:.2f} %", f"{100 * b:.2f} %", f"{100 * (a - b):+.2f} %",
         f"≤ 0.5 %: {'yes' if abs(a - b) <= 5e-3 else 'NO'}")
        for name, a, b in rows
    ]  # fmt: skip


def main() -> None:
    """Measure, write the tables."""
    given = options(__doc__ or "", size=200)
    rows = [measure(organ, given.size) for organ in organs()]
    text = (
        "## Coverage\n\n`python -m benchmarks.validation.coverage`: MiroCam on the centerline; "
        f"{POINTS} points on each triangle, Embree's rays from every\npose; fractions of the area, "
        "*frustum* of the vertices (VR-Caps' definition). The difference is symmetric.\n\n"
        + table(HEAD, rows)
        + "\n\n"
        + table(("closed form", "measured", "exact", "difference", "claimed"), closed_forms())
    )
    write_section(given.out, Path(__file__), text)


if __name__ == "__main__":
    main()
