"""Geometry: rigid transforms as 4×4 matrices, directions, triangles, walls and edge graphs.

``T_a_b`` maps points from frame b to frame a: ``p_a = transform_points(T_a_b, p_b)``; it is also
the pose of b in a. Quaternions are ``wxyz``. Functions of transforms accept leading batch axes.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from vrcaps import _core
from vrcaps._core import Wall
from vrcaps.core.errors import InputError

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from scipy.sparse import coo_array

_UNIT = 0.01
"""Maximum deviation of a stored quaternion's length from 1."""
_MAX_POSITION = 1e9
"""Maximum magnitude of positions in valid data [m]; differences of larger ones overflow."""


def transform_from(
    rotation: Float[np.ndarray, "*batch 3 3"], translation: Float[np.ndarray, "*batch 3"]
) -> Float[np.ndarray, "*batch 4 4"]:
    """Compose ``T_a_b`` from the rotation ``R_a_b`` and the origin of b in a [m]."""
    rotation, translation = np.asarray(rotation, float), np.asarray(translation, float)
    batch = rotation.shape[:-2]
    if batch != translation.shape[:-1]:
        batch = np.broadcast_shapes(batch, translation.shape[:-1])
    transform = np.zeros((*batch, 4, 4))
    transform[..., :3, :3] = rotation
    transform[..., :3, 3] = translation
    transform[..., 3, 3] = 1.0
    return transform


def invert(transform: Float[np.ndarray, "*batch 4 4"]) -> Float[np.ndarray, "*batch 4 4"]:
    """Inverse ``T_b_a`` of a rigid ``T_a_b``."""
    rotation = np.swapaxes(transform[..., :3, :3], -1, -2)
    return transform_from(rotation, -(rotation @ transform[..., :3, 3:])[..., 0])


def transform_points(
    transform: Float[np.ndarray, "*batch 4 4"], points: Float[np.ndarray, "*batch n 3"]
) -> Float[np.ndarray, "*batch n 3"]:
    """Transform points from frame b to frame a, given ``T_a_b``."""
    rotation, translation = transform[..., :3, :3], transform[..., None, :3, 3]
    return points @ np.swapaxes(rotation, -1, -2) + translation


def rotate_vectors(
    transform: Float[np.ndarray, "*batch 4 4"], vectors: Float[np.ndarray, "*batch n 3"]
) -> Float[np.ndarray, "*batch n 3"]:
    """Rotate directions from frame b to frame a, given ``T_a_b``."""
    return vectors @ np.swapaxes(transform[..., :3, :3], -1, -2)


def matrix_from_quaternion(
    wxyz: Float[np.ndarray, "*batch 4"],
) -> Float[np.ndarray, "*batch 3 3"]:
    """Rotation matrix of a quaternion, which need not be of unit length.

    Raises:
        InputError: If a quaternion is zero or not finite.
    """
    wxyz = np.asarray(wxyz, float)
    norm = np.sqrt((wxyz * wxyz).sum(axis=-1, keepdims=True))
    if not ((norm > 0.0) & (norm < np.inf)).all():
        raise InputError(
            "A quaternion is zero or not finite. Allowed: a finite wxyz of nonzero length."
        )
    unit = wxyz / norm
    # A single one is computed with Python floats, which are many times as fast as NumPy's.
    w, x, y, z = unit.tolist() if unit.ndim == 1 else np.moveaxis(unit, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    rotation = np.array(rows)
    return np.ascontiguousarray(rotation.transpose(*range(2, rotation.ndim), 0, 1))


def matrix_from_unit_quaternion(
    wxyz: Float[np.ndarray, "*batch 4"], what: object
) -> Float[np.ndarray, "*batch 3 3"]:
    """Rotation matrix of a quaternion from a file, of unit length up to rounding.

    Args:
        wxyz: The quaternion.
        what: The file, for messages.

    Raises:
        InputError: If a quaternion is not finite, or its length is not 1 within 1 %.
    """
    length = np.linalg.norm(np.asarray(wxyz, float), axis=-1).ravel()
    wrong = np.flatnonzero(~(np.abs(length - 1.0) <= _UNIT))
    if len(wrong):
        raise InputError(
            f"{what} contains a quaternion of length {length[wrong[0]]:.4g} (pose {wrong[0]}). "
            "Allowed: 1."
        )
    return matrix_from_quaternion(wxyz)


def require_rigid(
    transforms: Float[np.ndarray, "*batch 4 4"], what: object, tolerance: float = 1e-3
) -> None:
    """Check that matrices from data are rigid transforms.

    Args:
        transforms: The matrices.
        what: Source of the matrices, for messages.
        tolerance: Maximum deviation of ``R Rᵀ`` from the identity, since files round.

    Raises:
        InputError: If one is not finite, its rotation is not orthonormal and right-handed, or its
            last row is not 0 0 0 1.
    """
    matrices = np.asarray(transforms, float)
    if matrices.shape[-2:] != (4, 4):
        raise InputError(
            f"{what} is not a rigid transform: its shape is {matrices.shape}, not 4×4."
        )
    matrices = matrices.reshape(-1, 4, 4)
    finite = np.all(np.abs(matrices) < _MAX_POSITION, axis=(1, 2))  # not of NaN
    safe = np.where(finite[:, None, None], matrices, np.eye(4))
    rotation = np.clip(safe[:, :3, :3], -2.0, 2.0)
    off = np.abs(rotation @ np.swapaxes(rotation, 1, 2) - np.eye(3)).max(axis=(1, 2), initial=0.0)
    rigid = finite & (off <= tolerance) & (np.linalg.det(rotation) > 0.0)
    rigid &= np.abs(safe[:, 3] - [0.0, 0.0, 0.0, 1.0]).max(axis=1, initial=0.0) <= tolerance
    wrong = np.flatnonzero(~rigid)
    if len(wrong):
        problem = (
            "is not a rigid transform" if finite[wrong[0]] else "is not finite or beyond 1e9 m"
        )
        raise InputError(
            f"{what} {problem} (matrix {wrong[0]}). Allowed: a rotation with determinant 1, a "
            "position in finite numbers, and a last row 0 0 0 1."
        )


def quaternion_from_matrix(
    rotation: Float[np.ndarray, "*batch 3 3"],
) -> Float[np.ndarray, "*batch 4"]:
    """Unit quaternion ``wxyz`` with w ≥ 0 of a rotation matrix (Shepperd's method, 1978)."""
    rotation = np.asarray(rotation, float)
    m00, m11, m22 = (rotation[..., i, i] for i in range(3))
    squares = np.stack([m00 + m11 + m22, m00 - m11 - m22, m11 - m00 - m22, m22 - m00 - m11], -1)
    # Four times the outer product q qᵀ: its row with the largest diagonal is well conditioned.
    outer = np.zeros((*rotation.shape[:-2], 4, 4))
    outer[..., range(4), range(4)] = 1.0 + squares
    for i, j, k in ((1, 2, 3), (2, 3, 1), (3, 1, 2)):
        below, above = rotation[..., k - 1, j - 1], rotation[..., j - 1, k - 1]
        outer[..., 0, i] = outer[..., i, 0] = below - above
        outer[..., j, k] = outer[..., k, j] = below + above
    best = np.argmax(squares, axis=-1)
    wxyz = np.take_along_axis(outer, best[..., None, None], axis=-2)[..., 0, :]
    wxyz = wxyz / np.linalg.norm(wxyz, axis=-1, keepdims=True)
    return np.where(wxyz[..., :1] < 0.0, -wxyz, wxyz)


def look_along(
    forward: Float[np.ndarray, "*batch 3"], up: Float[np.ndarray, "*batch 3"]
) -> Float[np.ndarray, "*batch 3 3"]:
    """Rotation whose z axis is `forward` and whose y axis is as close as possible to −`up`.

    This is a camera's rotation ``R_world_camera`` (x right, y down, z forward).

    Raises:
        InputError: If `forward` is zero or parallel to `up`.
    """
    z = np.asarray(forward, float)
    x = np.cross(z, np.broadcast_to(up, z.shape))
    lengths = [np.linalg.norm(v, axis=-1, keepdims=True) for v in (z, x)]
    if not np.all((lengths[0] > 0.0) & (lengths[1] > 1e-9 * lengths[0])):
        raise InputError("Viewing direction is zero or parallel to up. Give another up direction.")
    z, x = z / lengths[0], x / lengths[1]
    return np.stack([x, np.cross(z, x), z], axis=-1)


def rotation_vector(
    R_world_a: Float[np.ndarray, "*batch 3 3"], R_world_b: Float[np.ndarray, "*batch 3 3"]
) -> Float[np.ndarray, "*batch 3"]:
    """Axis times angle [rad] of the rotation from a to b, in the world frame.

    The angle is between 0 and π.
    """
    wxyz = quaternion_from_matrix(R_world_b @ np.swapaxes(R_world_a, -1, -2))
    sine = np.linalg.norm(wxyz[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, wxyz[..., :1])
    # sin(x)/x → 1: for tiny angles the vector is twice the quaternion's imaginary part.
    return np.where(sine > 1e-12, angle / np.maximum(sine, 1e-12), 2.0) * wxyz[..., 1:]


def velocities_between(
    Ts_world_a: Float[np.ndarray, "n 4 4"],
    Ts_world_b: Float[np.ndarray, "n 4 4"],
    duration: Float[np.ndarray, " n"] | float,
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Mean linear [m/s] and angular [rad/s] velocity from poses a to poses b in `duration` [s]."""
    duration = np.asarray(duration)[..., None]
    linear = (Ts_world_b[:, :3, 3] - Ts_world_a[:, :3, 3]) / duration
    angular = rotation_vector(Ts_world_a[:, :3, :3], Ts_world_b[:, :3, :3]) / duration
    return linear, angular


def rotation_from_vector(vector: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3 3"]:
    """Rotation matrix of an axis times an angle [rad]."""
    half = 0.5 * np.linalg.norm(vector, axis=-1, keepdims=True)
    # np.sinc(x) = sin(πx)/(πx), so the imaginary part is sin(half)/half · vector/2.
    return matrix_from_quaternion(
        np.concatenate([np.cos(half), 0.5 * np.sinc(half / np.pi) * vector], axis=-1)
    )


def vector_from_rotation(rotation: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, " 3"]:
    """Axis times angle [rad] of one rotation matrix, 0 to π; compiled, for control loops."""
    return _core.rotation_vector(rotation)


def rotate_by_vector(
    vector: Float[np.ndarray, " 3"], rotation: Float[np.ndarray, "3 3"]
) -> Float[np.ndarray, "3 3"]:
    """Rotate one rotation matrix by a rotation vector [rad] in the same outer frame.

    Compiled, for control loops; the result is orthonormal.
    """
    return _core.rotate_by_vector(vector, rotation)


def unit(vectors: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
    """Normalize vectors to length 1; a zero vector stays zero."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.maximum(length, np.finfo(float).tiny)


def smoothstep(x: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """3x² − 2x³ between 0 and 1, constant beyond."""
    x = np.clip(x, 0.0, 1.0)
    return x * x * (3.0 - 2.0 * x)


_CREASE = 0.65
"""Half width of a crease between folds, in standard deviations of the field of folds."""


def fold_profile(field: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """Height of folds between creases: 0 at the zeros of a field, 1 − exp(−(f/c)²) elsewhere.

    The zeros of one smooth random field do not cross, so that folds are rounded strips without
    corners; c is 0.65.

    Args:
        field: Field f of unit standard deviation.
    """
    return 1.0 - np.exp(-((field / _CREASE) ** 2))


def triangle_normals(corners: Float[np.ndarray, "m 3 3"]) -> Float[np.ndarray, "m 3"]:
    """Normal of each triangle by the right-hand rule; its length is twice the area [m²]."""
    return cross_products(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def cross_products(
    one: Float[np.ndarray, "n 3"], other: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 3"]:
    """Cross products of rows, three times as fast as `np.cross`."""
    (x, y, z), (a, b, c) = one.T, other.T
    return np.stack([y * c - z * b, z * a - x * c, x * b - y * a], axis=1)


def triangle_areas(corners: Float[np.ndarray, "m 3 3"]) -> Float[np.ndarray, " m"]:
    """Area of each triangle [m²]."""
    return 0.5 * np.linalg.norm(triangle_normals(corners), axis=1)


def barycentric(
    points: Float[np.ndarray, "n 3"], corners: Float[np.ndarray, "n 3 3"]
) -> Float[np.ndarray, "n 3"]:
    """Barycentric coordinates of a point in the plane of each triangle, 0 to 1.

    They are ratios of signed areas, clipped for points just outside the triangle.
    """
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    area = np.cross(b - a, c - a)
    square = np.einsum("nx,nx->n", area, area)
    square = np.where(square > 0.0, square, 1.0)
    of_b = np.einsum("nx,nx->n", np.cross(points - a, c - a), area) / square
    of_c = np.einsum("nx,nx->n", np.cross(b - a, points - a), area) / square
    return np.clip(np.stack([1.0 - of_b - of_c, of_b, of_c], axis=1), 0.0, 1.0)


def edge_graph(vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]) -> coo_array:
    """Sparse adjacency matrix of a mesh: the length [m] of every edge, in both directions."""
    from scipy.sparse import coo_array

    n = len(vertices)
    ends = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64), axis=1)
    key = np.sort(ends[:, 0] * n + ends[:, 1])
    one, other = np.divmod(key[np.diff(key, prepend=-1) > 0], n)  # np.unique takes ten times longer
    length = np.linalg.norm(vertices[one] - vertices[other], axis=1)
    rows, columns = np.concatenate([one, other]), np.concatenate([other, one])
    return coo_array((np.tile(length, 2), (rows, columns)), shape=(n, n))


def length(vector: Float[np.ndarray, " 3"]) -> float:
    """Euclidean norm of a vector."""
    return math.sqrt(float(vector @ vector))


def clamp_norm(vector: Float[np.ndarray, " 3"], limit: float) -> Float[np.ndarray, " 3"]:
    """Shorten a vector to a norm of at most `limit`, keeping its direction."""
    size = length(vector)
    return vector if size <= limit else vector * (limit / size)


def detour(
    start: Float[np.ndarray, " 3"],
    end: Float[np.ndarray, " 3"],
    center: Float[np.ndarray, " 3"],
    radius: float,
) -> Float[np.ndarray, " 3"]:
    """Next waypoint on the way from `start` to `end` around a sphere.

    It is `end` if the straight line misses the sphere. Otherwise it lies beyond the point at which
    a straight line from `start` touches the sphere, on the side of the line to `end`. An `end`
    inside the sphere is moved to its surface.
    """
    out = end - center
    end = center + out * max(1.0, radius / max(length(out), 1e-12))
    from_center = start - center
    step = end - start
    fraction = -float(from_center @ step) / max(float(step @ step), 1e-12)
    nearest = from_center + min(fraction, 1.0) * step
    if fraction <= 0.0 or length(nearest) >= (1.0 - 1e-9) * radius:
        return end
    distance = max(length(from_center), 1e-12)
    back = from_center / distance
    aside = nearest - (nearest @ back) * back
    if length(aside) < 1e-6 * radius:  # the line passes through the center
        aside = np.cross(back, np.eye(3)[np.argmin(np.abs(back))])
    aside = aside / length(aside)
    cosine = min(1.0, radius / distance)
    sine = math.sqrt(1.0 - cosine * cosine)
    ahead = min(radius, length(step))
    tangent_point = radius * (cosine * back + sine * aside)
    return center + tangent_point + ahead * (cosine * aside - sine * back)


def wall_of(vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]) -> Wall:
    """Wall of a surface, for queries in the frame of its vertices [m]."""
    return Wall(np.ascontiguousarray(vertices, float), np.ascontiguousarray(faces, np.int64))


def octahedral_directions(size: int) -> Float[np.ndarray, "size size 3"]:
    """Unit directions at the centers of the cells of an unfolded octahedron.

    The cell in row i and column j has v = (2 i + 1) / size − 1 and u alike; |u| + |v| ≤ 1 is the
    half with z ≥ 0 (Cigolle et al., J. Computer Graphics Techniques 3(2), 2014).
    """
    w = (2.0 * np.arange(size) + 1.0) / size - 1.0
    v, u = np.meshgrid(w, w, indexing="ij")
    z = 1.0 - np.abs(u) - np.abs(v)
    x = np.where(z < 0.0, np.copysign(1.0 - np.abs(v), u), u)
    y = np.where(z < 0.0, np.copysign(1.0 - np.abs(u), v), v)
    directions = np.stack([x, y, z], axis=-1)
    return directions / np.linalg.norm(directions, axis=-1, keepdims=True)
