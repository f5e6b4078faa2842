"""Full tract generator: stomach, small bowel and colon as one wall, from the cardia to the anus."""

from __future__ import annotations

from dataclasses import asdict, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.anatomy.catalog import organ_generator
from vrcaps.anatomy.colon import generate_colon
from vrcaps.anatomy.colon.parameters import SEGMENTS as COLON_SEGMENTS
from vrcaps.anatomy.full_tract.patient import GAP, ColonPlacement, place_colon
from vrcaps.anatomy.full_tract.textures import JoinedFaces, tract_coordinates, with_appearance
from vrcaps.anatomy.full_tract.tube import (
    CAP,
    VALVE_ACROSS,
    VALVE_ALONG,
    UpperTract,
    lay_upper_tract,
)
from vrcaps.anatomy.small_bowel import small_bowel_labels, small_bowel_rng
from vrcaps.anatomy.small_bowel.parameters import SEGMENTS as BOWEL_SEGMENTS
from vrcaps.anatomy.stomach import stomach_labels, stomach_path
from vrcaps.anatomy.stomach.parameters import SEGMENTS as STOMACH_SEGMENTS
from vrcaps.anatomy.tube_mesh.surface_to_organ import (
    CENTERLINE_STEP,
    TubeMesh,
    angle_and_radius,
    arc_length_of_sections,
    first_sound,
    mesh_tube,
    require_sound,
)
from vrcaps.anatomy.tube_mesh.tube import Course, make_tube
from vrcaps.core.units import CM, MM
from vrcaps.mesh.mesh import Mesh, directed_edges, face_areas, vertex_normals
from vrcaps.organ.centerline import centerline_from_points
from vrcaps.organ.surface import Centerline, OrganSurface

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

    from vrcaps.anatomy.colon.parameters import ColonParameters
    from vrcaps.anatomy.full_tract.patient import PatientAnatomy
    from vrcaps.anatomy.small_bowel.parameters import SmallBowelParameters
    from vrcaps.anatomy.stomach.parameters import StomachParameters


FULL_TRACT_COLON_TRIANGLES = 150_000
"""Number of triangles of the colon in the joint tract, for the same edge length of 2 mm."""
_NUM_SMOOTHINGS = 12
_NUM_RINGS = 4


def without_vertices(
    faces: Int[np.ndarray, "m 3"], is_removed: Bool[np.ndarray, " n"]
) -> tuple[Bool[np.ndarray, " m"], Int[np.ndarray, " k"]]:
    """Mask of the faces left after removing vertices, and the ordered rim of the hole.

    The rim has the orientation of its faces; of several holes, the longest rim is returned.
    """
    is_kept = np.logical_not(is_removed[faces].any(axis=1))
    halves = directed_edges(faces[is_kept])
    num = len(is_removed)
    is_single = ~np.isin(halves[:, 0] * num + halves[:, 1], halves[:, 1] * num + halves[:, 0])
    following = dict(halves[is_single].tolist())
    longest: list[int] = []
    while following:
        start, at = next(iter(following.items()))
        loop = [start]
        del following[start]
        while at != start and at in following:
            loop.append(at)
            at = following.pop(at)
        if len(loop) > len(longest):
            longest = loop
    return np.asarray(is_kept), np.array(longest)


def stitch(
    vertices: Float[np.ndarray, "n 3"],
    one: Int[np.ndarray, " k"],
    other: Int[np.ndarray, " l"],
) -> Int[np.ndarray, "m 3"]:
    """Faces of the band between two opposite rims.

    Args:
        vertices: Vertices of both walls [m].
        one: First rim, in the orientation of its faces.
        other: Second rim, in the orientation of its faces, thus opposite to the first.
    """
    other = other[::-1]
    nearest = np.linalg.norm(vertices[other] - vertices[one[0]], axis=1).argmin()
    other = np.roll(other, -nearest)
    fractions = [_fractions(vertices, rim) for rim in (one, other)]
    mids = [0.5 * (fraction[1:] + fraction[:-1]) for fraction in fractions]
    across = [np.searchsorted(mids[1], mids[0]), np.searchsorted(mids[0], mids[1], "right")]
    first = np.stack([np.roll(one, -1), one, other[across[0] % len(other)]], axis=1)
    second = np.stack([other, np.roll(other, -1), one[across[1] % len(one)]], axis=1)
    return np.concatenate([first, second])


def soften(
    vertices: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"],
    rim: Int[np.ndarray, " k"],
) -> Float[np.ndarray, "n 3"]:
    """Smooth vertices towards the mean of their neighbors, with strength falling off from a rim.

    Args:
        vertices: Positions [m].
        faces: Vertex indices.
        rim: Vertices around which the wall is smoothed.
    """
    edges = directed_edges(faces)
    ring = np.full(len(vertices), _NUM_RINGS)
    ring[rim] = 0
    for distance in range(1, _NUM_RINGS):
        reached = edges[ring[edges[:, 0]] == distance - 1, 1]
        ring[reached] = np.minimum(ring[reached], distance)
    edges = edges[ring[edges[:, 0]] < _NUM_RINGS]
    count = np.maximum(np.bincount(edges[:, 0], minlength=len(vertices)), 1)
    weight = (0.5 * (1.0 - ring / _NUM_RINGS))[:, None]
    vertices = vertices.copy()
    for _ in range(_NUM_SMOOTHINGS):
        mean = np.stack(
            [np.bincount(edges[:, 0], vertices[edges[:, 1], k], len(vertices)) for k in range(3)],
            axis=1,
        )
        vertices += weight * (mean / count[:, None] - vertices)
    return vertices


def _fractions(vertices: np.ndarray, rim: np.ndarray) -> Float[np.ndarray, " k"]:
    """Fraction of a closed rim's length at each vertex and, last, back at the first."""
    step = np.linalg.norm(vertices[np.roll(rim, -1)] - vertices[rim], axis=1)
    return np.append(0.0, np.cumsum(step)) / step.sum()


_NUM_TRIES = 6
_GAP_STEP = 6 * MM
_RIM = 1.3 * MM
_VALVE_REACH = 4 * CM


def generate_full_tract(
    stomach: StomachParameters,
    bowel: SmallBowelParameters,
    colon: ColonParameters,
    *,
    seed: int,
) -> OrganSurface:
    """Generate stomach, small bowel and colon as one closed wall with one centerline.

    The stomach continues into the bulb at the pyloric ring; the ileum ends in the lips of the
    ileocaecal valve. The texture coordinates place the three parts side by side, see
    `metadata["texture_parts"]`.

    Args:
        stomach: The patient's stomach.
        bowel: The patient's small bowel.
        colon: The patient's colon.
        seed: Seed of all random properties.

    Raises:
        InputError: If the organs do not fit into the abdomen or intersect each other.
    """
    lower = generate_colon(colon, seed=seed)
    line = lower.centerline
    placement = place_colon(colon, Course(line.points, line.arc_length))
    rng = small_bowel_rng(seed)

    def draw(attempt: int) -> OrganSurface:
        # A fundus that bulges to one side can extend beyond its mean outline into the colon.
        gap = GAP + attempt * _GAP_STEP
        tract = lay_upper_tract(stomach, bowel, placement, seed=seed, rng=rng, gap=gap)
        return _join(tract, lower, placement, seed)

    return first_sound(
        [partial(draw, attempt) for attempt in range(_NUM_TRIES)],
        f"tract of seed {seed} without self-intersection. Allowed: a shorter or narrower "
        "small bowel, or another seed",
    )


def _join(
    tract: UpperTract, lower: OrganSurface, placement: ColonPlacement, seed: int
) -> OrganSurface:
    """Stitch both walls at the valve, with labels, gut coordinates and centerline."""
    upper = mesh_tube(tract.surface())
    vertices, faces, joined = _stitched(tract, upper, lower, placement)
    used, own = np.unique(faces, return_inverse=True)
    require_sound("full-tract", vertices[used], own.reshape(-1, 3))
    uv, parts = tract_coordinates(joined, vertices)
    vertices, faces = vertices[used], own.reshape(-1, 3).astype(np.int32)
    centerline = _centerline(tract, lower.centerline, placement, vertices, faces)
    arc_length = _arc_length(tract, upper, lower, centerline)[used]
    theta, radius = angle_and_radius(vertices, arc_length, centerline)
    return OrganSurface(
        name="full-tract",
        vertices=vertices,
        faces=faces,
        normals=vertex_normals(vertices, faces),
        uv=uv,
        label=_labels(tract, upper, lower)[used],
        label_names=("background", *STOMACH_SEGMENTS, *BOWEL_SEGMENTS, *COLON_SEGMENTS),
        instance=np.zeros(len(vertices), np.uint16),
        arc_length=arc_length,
        theta=theta,
        radius=radius,
        centerline=centerline,
        metadata=_metadata(tract, lower, seed) | {"texture_parts": parts},
    )


def _stitched(
    tract: UpperTract, upper: TubeMesh, lower: OrganSurface, placement: ColonPlacement
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "m 3"], JoinedFaces]:
    """Vertices [m] and faces of both walls joined at the valve, and the origin of each face."""
    num = len(upper.vertices)
    kept_upper, rim_upper = without_vertices(upper.faces, upper.arc_length > tract.end - 1.05 * CAP)
    kept_lower, rim_lower = without_vertices(lower.faces, _is_in_valve(lower, placement))
    vertices = np.concatenate([upper.vertices, lower.vertices])
    band = stitch(vertices, rim_upper, rim_lower + num)
    faces = np.concatenate([upper.faces[kept_upper], lower.faces[kept_lower] + num, band])
    vertices = soften(vertices, faces, np.concatenate([rim_upper, rim_lower + num]))
    in_stomach = upper.arc_length[upper.faces].mean(axis=1) < tract.pylorus
    joined = JoinedFaces(
        upper,
        in_stomach,
        kept_upper & ~in_stomach,
        band,
        lower.uv[kept_lower],
        float(face_areas(Mesh(lower.vertices, lower.faces)).sum()),
    )
    return vertices, faces, joined


def _metadata(tract: UpperTract, lower: OrganSurface, seed: int) -> dict:
    """Provenance of the tract."""
    return {
        "generator": "full-tract",
        "seed": seed,
        "parameters": {
            "stomach": asdict(tract.stomach.parameters),
            "small_bowel": asdict(tract.bowel.parameters),
            "colon": lower.metadata["parameters"],
        },
    }


def _is_in_valve(colon: OrganSurface, placement: ColonPlacement) -> np.ndarray:
    """Mask of the colon's vertices within the opening between the lips of the valve."""
    offset = colon.vertices - placement.valve
    along = offset @ placement.along / (VALVE_ALONG + _RIM)
    across = offset @ np.cross(placement.inward, placement.along) / (VALVE_ACROSS + _RIM)
    depth = np.abs(offset @ placement.inward)
    # Another loop of the colon can touch the valve from outside.
    is_near = (
        np.abs(colon.arc_length - _valve_arc_length(colon.centerline, placement)) < _VALVE_REACH
    )
    return is_near & (along**2 + across**2 < 1.0) & (depth < 20 * MM)


def _labels(tract: UpperTract, upper: TubeMesh, lower: OrganSurface) -> np.ndarray:
    """Segment labels of the vertices of both walls."""
    s, num = upper.arc_length, len(STOMACH_SEGMENTS)
    in_stomach = stomach_labels(tract.stomach, np.minimum(s, tract.pylorus), upper.theta)
    in_bowel = small_bowel_labels(tract.bowel.parameters, s - tract.pylorus)
    both = np.where(s < tract.pylorus, in_stomach, in_bowel + num)
    return np.concatenate([both, lower.label + num + len(BOWEL_SEGMENTS)]).astype(np.uint8)


def _centerline(
    tract: UpperTract,
    colon: Centerline,
    placement: ColonPlacement,
    vertices: np.ndarray,
    faces: np.ndarray,
) -> Centerline:
    """Centerline from inside the cardia along the tube, through the valve and along the colon."""
    start = stomach_path(tract.stomach)
    start = start[: len(start) - 6]
    _, nearest = min(
        (np.linalg.norm(point - start[-1]), i)
        for i, point in enumerate(tract.tube.curve(tract.tube.arc_length)[:400])
    )
    stops = np.arange(tract.tube.arc_length[nearest] + 6 * MM, tract.end - 8 * MM, 6 * MM)
    entry = tract.tube.curve(np.array([tract.end]))[0]
    after = (
        entry
        + np.outer([4 * MM, 10 * MM], placement.inward)
        + np.outer([0.0, 3 * MM], placement.along)
    )
    at = _valve_arc_length(colon, placement)
    beyond = np.arange(at + 4 * CM, colon.length - 6 * MM, 8 * MM)
    index = np.searchsorted(colon.arc_length, beyond)
    points = [start, tract.tube.curve(stops), entry[None], after, colon.points[index]]
    return centerline_from_points(np.concatenate(points), vertices, faces, step=CENTERLINE_STEP)


def _valve_arc_length(colon: Centerline, placement: ColonPlacement) -> float:
    """Arc length of the valve on the colon's own centerline [m]."""
    nearest = np.argmin(np.linalg.norm(colon.points - placement.valve, axis=1))
    return float(colon.arc_length[nearest])


def _arc_length(
    tract: UpperTract, upper: TubeMesh, lower: OrganSurface, centerline: Centerline
) -> Float[np.ndarray, " n"]:
    """Arc length of the vertices of both walls: that of their section on the joint centerline."""
    entry = tract.tube.curve(np.array([tract.end]))[0]
    split = int(np.argmin(np.linalg.norm(centerline.points - entry, axis=1)))
    before, after = (
        Centerline(
            centerline.points[part],
            centerline.arc_length[part],
            centerline.radius[part],
            centerline.frames[part],
        )
        for part in (slice(0, split + 1), slice(split, None))
    )
    colon = lower.centerline
    course = make_tube(Course(colon.points, colon.arc_length))
    return np.concatenate(
        [
            arc_length_of_sections(upper.arc_length, tract.tube, before),
            arc_length_of_sections(lower.arc_length, course, after),
        ]
    )


@organ_generator("full-tract")
def full_tract_of(patient: PatientAnatomy) -> OrganSurface:
    """Generate a patient's full tract with the appearance of its parts."""
    colon = replace(patient.colon, triangles=FULL_TRACT_COLON_TRIANGLES)
    organ = generate_full_tract(patient.stomach, patient.small_bowel, colon, seed=patient.seed)
    return with_appearance(organ, seed=patient.seed)
