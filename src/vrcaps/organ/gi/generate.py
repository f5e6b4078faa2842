"""The whole tract of one patient as one wall, from the cardia to the anus."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.errors import InputError
from vrcaps.organ.centerline import centerline_from_points
from vrcaps.organ.colon import generate_colon
from vrcaps.organ.colon.parameters import SEGMENTS as COLON_SEGMENTS
from vrcaps.organ.crossing import self_intersections
from vrcaps.organ.gi.abdomen import ColonPlace, place_colon
from vrcaps.organ.gi.tube import CAP, VALVE_ACROSS, VALVE_ALONG, UpperTract, lay_upper_tract
from vrcaps.organ.gi.valve import soften, stitch, without_vertices
from vrcaps.organ.repair.edges import face_areas
from vrcaps.organ.shape.coordinates import angle_and_radius, arc_length_of_sections
from vrcaps.organ.shape.rows import mesh_skin
from vrcaps.organ.shape.skin import make_meridian, turns
from vrcaps.organ.shape.tube import Course, make_tube
from vrcaps.organ.small_bowel.generate import small_bowel_labels
from vrcaps.organ.small_bowel.parameters import SEGMENTS as BOWEL_SEGMENTS
from vrcaps.organ.stomach.generate import stomach_labels, stomach_path
from vrcaps.organ.stomach.parameters import SEGMENTS as STOMACH_SEGMENTS
from vrcaps.organ.surface import Centerline, Mesh, OrganSurface, vertex_normals
from vrcaps.organ.texture_charts import TubeChart, chart_coordinates
from vrcaps.units import CM, MM

if TYPE_CHECKING:
    from jaxtyping import Float, Int

    from vrcaps.organ.colon.parameters import ColonParameters
    from vrcaps.organ.small_bowel.parameters import SmallBowelParameters
    from vrcaps.organ.stomach.parameters import StomachParameters

_NUM_TRIES = 3
_RIM = 1.3 * MM


@dataclass(frozen=True)
class _Upper:
    """The upper tract's triangles before they are joined to the colon.

    Attributes:
        tract: The walls.
        s: Arc length of each vertex on the tract's tube [m].
        theta: Angle of each vertex [rad].
        vertices: Positions [m].
        faces: Vertex numbers.
        turn: Way around from the seam at each corner, 0 to 1.
        along: Meridian length at each corner [m].
    """

    tract: UpperTract
    s: Float[np.ndarray, " n"]
    theta: Float[np.ndarray, " n"]
    vertices: Float[np.ndarray, "n 3"]
    faces: Int[np.ndarray, "m 3"]
    turn: Float[np.ndarray, "m 3"]
    along: Float[np.ndarray, "m 3"]


def generate_gi(
    stomach: StomachParameters,
    bowel: SmallBowelParameters,
    colon: ColonParameters,
    *,
    seed: int,
) -> OrganSurface:
    """Stomach, small bowel and colon as one closed wall with one centreline.

    The stomach passes into the bulb at the pyloric ring; the ileum ends in the lips of the
    ileocaecal valve. The texture coordinates hold the three parts side by side, see
    `metadata["texture_parts"]`.

    Args:
        stomach: The patient's stomach.
        bowel: The patient's small bowel.
        colon: The patient's colon.
        seed: Of everything drawn.

    Raises:
        InputError: If the organs do not fit into the abdomen, or cut one another.
    """
    lower = generate_colon(colon, seed=seed)
    line = lower.centerline
    place = place_colon(colon, Course(line.points, line.arc_length))
    rng = np.random.default_rng([seed, 3])
    for _ in range(_NUM_TRIES):
        upper = _mesh_upper(lay_upper_tract(stomach, bowel, place, seed=seed, rng=rng))
        organ = _join(upper, lower, place, seed)
        if not len(self_intersections(organ.vertices, organ.faces)):
            return organ
    raise InputError(
        f"Found no tract of seed {seed} that does not cut itself. Allowed: a shorter or narrower "
        "small bowel, or another seed."
    )


def _mesh_upper(tract: UpperTract) -> _Upper:
    skin = tract.skin()
    grid = mesh_skin(skin)
    s = make_meridian(skin).to_arc_length(grid.along)
    radius = skin.radius(s, grid.theta)
    vertices = tract.tube.points(s, grid.theta, radius)
    faces = grid.faces
    return _Upper(tract, s, grid.theta, vertices, faces, turns(grid), grid.along[faces])


def _join(upper: _Upper, lower: OrganSurface, place: ColonPlace, seed: int) -> OrganSurface:
    """Both walls stitched at the valve, with labels, gut coordinates and centreline."""
    tract, num = upper.tract, len(upper.vertices)
    kept_upper, rim_upper = without_vertices(upper.faces, upper.s > tract.end - 1.05 * CAP)
    kept_lower, rim_lower = without_vertices(lower.faces, _is_in_valve(lower.vertices, place))
    vertices = np.concatenate([upper.vertices, lower.vertices])
    band = stitch(vertices, rim_upper, rim_lower + num)
    faces = np.concatenate([upper.faces[kept_upper], lower.faces[kept_lower] + num, band])
    vertices = soften(vertices, faces, np.concatenate([rim_upper, rim_lower + num]))
    uv, parts = _texture(upper, lower, (kept_upper, kept_lower), band, vertices)
    used, faces = np.unique(faces, return_inverse=True)
    vertices, faces = vertices[used], faces.reshape(-1, 3).astype(np.int32)
    centerline = _centerline(tract, lower.centerline, place, vertices, faces)
    arc_length = _arc_length(upper, lower, centerline)[used]
    theta, radius = angle_and_radius(vertices, arc_length, centerline)
    return OrganSurface(
        name="gi",
        vertices=vertices,
        faces=faces,
        normals=vertex_normals(vertices, faces),
        uv=uv,
        label=_labels(upper, lower)[used],
        label_names=("background", *STOMACH_SEGMENTS, *BOWEL_SEGMENTS, *COLON_SEGMENTS),
        instance=np.zeros(len(vertices), np.uint16),
        arc_length=arc_length,
        theta=theta,
        radius=radius,
        centerline=centerline,
        metadata={
            "generator": "gi",
            "seed": seed,
            "parameters": {
                "stomach": asdict(tract.stomach.parameters),
                "small_bowel": asdict(tract.bowel.parameters),
                "colon": lower.metadata["parameters"],
            },
            "texture_parts": parts,
        },
    )


def _is_in_valve(vertices: np.ndarray, place: ColonPlace) -> np.ndarray:
    """Vertices of the colon within the opening between the valve's lips."""
    offset = vertices - place.valve
    along = offset @ place.along / (VALVE_ALONG + _RIM)
    across = offset @ np.cross(place.inward, place.along) / (VALVE_ACROSS + _RIM)
    depth = np.abs(offset @ place.inward)
    return (along**2 + across**2 < 1.0) & (depth < 20 * MM)


def _labels(upper: _Upper, lower: OrganSurface) -> np.ndarray:
    """Segment numbers of both walls' vertices."""
    tract = upper.tract
    in_stomach = stomach_labels(tract.stomach, np.minimum(upper.s, tract.pylorus), upper.theta)
    in_bowel = small_bowel_labels(tract.bowel.parameters, upper.s - tract.pylorus)
    num = len(STOMACH_SEGMENTS)
    both = np.where(upper.s < tract.pylorus, in_stomach, in_bowel + num)
    return np.concatenate([both, lower.label + num + len(BOWEL_SEGMENTS)]).astype(np.uint8)


def _centerline(
    tract: UpperTract,
    colon: Centerline,
    place: ColonPlace,
    vertices: np.ndarray,
    faces: np.ndarray,
) -> Centerline:
    """From inside the cardia down the tube, through the valve and along the colon."""
    start = stomach_path(tract.stomach)
    start = start[: len(start) - 6]
    _, nearest = min(
        (np.linalg.norm(point - start[-1]), i)
        for i, point in enumerate(tract.tube.curve(tract.tube.arc_length)[:400])
    )
    stops = np.arange(tract.tube.arc_length[nearest] + 6 * MM, tract.end - 8 * MM, 6 * MM)
    entry = tract.tube.curve(np.array([tract.end]))[0]
    after = entry + np.outer([4 * MM, 10 * MM], place.inward) + np.outer([0.0, 3 * MM], place.along)
    at = _valve_place(colon, place)
    beyond = np.arange(at + 4 * CM, colon.length - 6 * MM, 8 * MM)
    index = np.searchsorted(colon.arc_length, beyond)
    points = [start, tract.tube.curve(stops), entry[None], after, colon.points[index]]
    return centerline_from_points(np.concatenate(points), vertices, faces, step=1.5 * MM)


def _valve_place(colon: Centerline, place: ColonPlace) -> float:
    """Arc length on the colon's own centreline at which the valve lies [m]."""
    nearest = np.argmin(np.linalg.norm(colon.points - place.valve, axis=1))
    return float(colon.arc_length[nearest])


def _arc_length(
    upper: _Upper, lower: OrganSurface, centerline: Centerline
) -> Float[np.ndarray, " n"]:
    """Gut coordinate of both walls' vertices: that of their section on the joint centreline."""
    tract = upper.tract
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
            arc_length_of_sections(upper.s, tract.tube, before),
            arc_length_of_sections(lower.arc_length, course, after),
        ]
    )


def _texture(
    upper: _Upper,
    lower: OrganSurface,
    kept: tuple[np.ndarray, np.ndarray],
    band: Int[np.ndarray, "k 3"],
    vertices: Float[np.ndarray, "n 3"],
) -> tuple[Float[np.ndarray, "m 3 2"], list[float]]:
    """Texture coordinates of stomach, small bowel and colon side by side, and where they part.

    The band at the valve belongs to the small bowel.
    """
    tract, num = upper.tract, len(upper.vertices)
    in_stomach = upper.s[upper.faces].mean(axis=1) < tract.pylorus
    # Corners on the colon's rim lie just beyond the tube's end, at the angle of the other corners.
    is_own = band < num
    own = np.minimum(band, num - 1)
    turn = 0.5 - upper.theta[own] / (2.0 * np.pi)
    first = np.take_along_axis(turn, is_own.argmax(axis=1)[:, None], axis=1)
    turn = np.where(is_own, turn - np.rint(turn - first), first)
    turn = np.clip(turn, 0.0, 1.0)
    end = upper.along[kept[0] & ~in_stomach].max()
    along = np.where(is_own, end - 0.3 * MM, end + 1.0 * MM)
    bowel = kept[0] & ~in_stomach
    tubes = [
        (upper.faces[in_stomach], upper.turn[in_stomach], upper.along[in_stomach]),
        (
            np.concatenate([upper.faces[bowel], band]),
            np.concatenate([upper.turn[bowel], turn]),
            np.concatenate([upper.along[bowel], along]) - upper.along[bowel].min(),
        ),
    ]
    charts = [
        *(chart_coordinates(TubeChart(f, vertices[f], t, a)) for f, t, a in tubes),
        lower.uv[kept[1]],
    ]
    areas = [face_areas(Mesh(vertices, f)).sum() for f, _, _ in tubes]
    width = np.sqrt([*areas, face_areas(Mesh(lower.vertices, lower.faces)).sum()])
    parts = np.concatenate([[0.0], np.cumsum(width)]) / width.sum()
    low, span = parts[:-1], np.diff(parts)
    scaled = [
        np.stack([low[k] + span[k] * chart[..., 0], width[k] / width.max() * chart[..., 1]], -1)
        for k, chart in enumerate(charts)
    ]
    order = np.argsort(
        np.concatenate([np.flatnonzero(in_stomach), np.flatnonzero(bowel)]), kind="stable"
    )
    num_bowel = int(bowel.sum())
    tube = np.concatenate([scaled[0], scaled[1][:num_bowel]])[order]
    return np.concatenate([tube, scaled[2], scaled[1][num_bowel:]]), parts.tolist()
