"""Wall from the lumen fraction, and the colon segments along it.

Sub-voxel isosurface, smoothing without shrinkage, decimation; segments follow from the course of
the centerline in the patient.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial import chebyshev
from scipy import ndimage
from scipy.sparse import coo_array, csr_array

from vrcaps.anatomy.colon.parameters import SEGMENTS, ColonParameters
from vrcaps.core.errors import InputError, import_extra
from vrcaps.core.geometry import triangle_areas
from vrcaps.core.units import MM
from vrcaps.mesh.mesh import Mesh
from vrcaps.tools.ct.fraction import LumenFraction

if TYPE_CHECKING:
    from jaxtyping import Float, Int, UInt8

    from vrcaps.organ.surface import Centerline

_HEPATIC_RANGE = (0.03, 0.45)  # fractions of the colon's length from the caecum
_SPLENIC_RANGE = (0.40, 0.80)


def runs_upwards(centerline: Centerline) -> bool:
    """Check whether a colon's centerline ends higher than it starts: the rectum lies lowest."""
    return bool(centerline.points[-1, 2] > centerline.points[0, 2])


def colon_borders(centerline: Centerline) -> Float[np.ndarray, " 7"]:
    """Arc lengths [m] at which the segments of a whole colon meet, from the caecum on.

    The hepatic flexure is the point farthest up and to the right in the first half of the course,
    the splenic one the point farthest up and to the left around its middle: loops of the transverse
    colon may rise as high, but between the two. Each flexure has its published fraction of the
    length. The stretches before, between and after them are divided in the published proportions
    (`ColonParameters`).

    Args:
        centerline: From the caecum to the rectum, patient frame.
    """
    mean = ColonParameters()
    length = {name: getattr(mean, name).length / mean.length for name in SEGMENTS}
    s, (left_of, _, height) = centerline.arc_length / centerline.length, centerline.points.T
    splenic = _farthest(s, height + left_of, _SPLENIC_RANGE)
    before = (_HEPATIC_RANGE[0], min(_HEPATIC_RANGE[1], splenic - 0.1))
    hepatic = _farthest(s, height - left_of, before)
    half_hepatic = min(length["hepatic_flexure"] / 2, 0.5 * hepatic)
    half_splenic = length["splenic_flexure"] / 2
    caecum, ascending = length["caecum"], length["ascending"]
    left = {name: length[name] for name in ("descending", "sigmoid", "rectum")}
    rest = (1.0 - splenic - half_splenic) / sum(left.values())
    descending = splenic + half_splenic + rest * left["descending"]
    borders = [
        (hepatic - half_hepatic) * caecum / (caecum + ascending),
        hepatic - half_hepatic,
        hepatic + half_hepatic,
        splenic - half_splenic,
        splenic + half_splenic,
        descending,
        descending + rest * left["sigmoid"],
    ]
    return centerline.length * np.array(borders)


def colon_labels(
    centerline: Centerline, arc_length: Float[np.ndarray, " n"]
) -> tuple[UInt8[np.ndarray, " n"], tuple[str, ...]]:
    """Segment of each vertex of a colon by its arc length, and the names of the segments."""
    label = 1 + np.searchsorted(colon_borders(centerline), arc_length)
    return label.astype(np.uint8), ("background", *SEGMENTS)


def _farthest(
    s: Float[np.ndarray, " n"], reach: Float[np.ndarray, " n"], between: tuple[float, float]
) -> float:
    """Position within a range of the course that is farthest in a direction."""
    inside = (s >= between[0]) & (s <= between[1])
    return float(s[inside][np.argmax(reach[inside])])


_FINEST = 1.5 * MM  # voxels longer than this are subdivided before the surface is extracted
_SLAB = 64  # slices that one thread blurs at a time
_TRUNCATE = 3.0  # standard deviations at which a Gaussian is truncated
_DEGREE = 16  # degree of the smoothing filter's polynomial, before it is flattened


def extract_wall(lumen: LumenFraction, *, blur: float, pass_band: float, edge: float) -> Mesh:
    """Extract the isosurface of the lumen fraction at one half, smoothed and decimated.

    Voxels longer than 1.5 mm are first subdivided by cubic interpolation. Where the lumen meets
    the first or last slice of the scan, the surface is open.

    Args:
        lumen: The lumen fraction.
        blur: Standard deviation of a blur over the fraction beforehand [voxels]; it turns a
            mask into a field with a sub-voxel surface and reduces noise.
        pass_band: Fraction of the mesh's spatial frequencies that smoothing keeps, see `smooth`.
        edge: Mean edge length of the triangles [m].

    Raises:
        InputError: If the fraction does not cross one half.
        MissingExtraError: If fast-simplification is not installed.
    """
    marching_cubes = import_extra("skimage.measure", "ct", package="scikit-image").marching_cubes

    fraction, transform = _refined(_blurred(lumen.fraction, blur), lumen)
    if not fraction.min() < 0.5 < fraction.max():
        raise InputError("The lumen is too small for the scan's voxels. Give a larger one.")
    index, faces, _, _ = marching_cubes(fraction, 0.5, allow_degenerate=False)
    vertices = index.astype(float) @ transform[:3, :3].T + transform[:3, 3]
    vertices = smooth(vertices, faces, pass_band)
    return decimate(Mesh(vertices, faces.astype(np.int64)), edge)


def _blurred(fraction: Float[np.ndarray, "k j i"], sigma: float) -> Float[np.ndarray, "k j i"]:
    """Convolve the fraction with the kernel 2 G − G² of a Gaussian G.

    Its second moment is zero, so curved walls keep their position: G alone would move a sphere of
    radius r inwards by σ² / r.
    """
    reach = 2 * int(_TRUNCATE * sigma + 0.5)
    blurred = np.empty_like(fraction)

    def fill(first: int) -> None:
        low = max(first - reach, 0)
        once = ndimage.gaussian_filter(
            fraction[low : first + _SLAB + reach], sigma, mode="nearest", truncate=_TRUNCATE
        )
        twice = ndimage.gaussian_filter(once, sigma, mode="nearest", truncate=_TRUNCATE)
        once *= 2.0
        once -= twice
        blurred[first : first + _SLAB] = once[first - low : first - low + _SLAB]

    with ThreadPoolExecutor() as pool:
        list(pool.map(fill, range(0, len(fraction), _SLAB)))
    return blurred


def _refined(
    fraction: Float[np.ndarray, "k j i"], lumen: LumenFraction
) -> tuple[Float[np.ndarray, "k j i"], Float[np.ndarray, "4 4"]]:
    """Resample the fraction and its `T_patient_index` to a grid no coarser than 1.5 mm."""
    factor = np.ceil(lumen.spacing / _FINEST - 1e-6).astype(int)
    if (factor <= 1).all():
        return fraction, lumen.T_patient_index
    size = (np.array(fraction.shape) - 1) * factor + 1
    ratio = size / fraction.shape
    finer = ndimage.zoom(fraction, ratio.tolist(), order=3, mode="nearest", grid_mode=False)
    transform = lumen.T_patient_index.copy()
    transform[:3, :3] /= factor
    return np.asarray(finer, np.float32), transform


def smooth(
    vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"], pass_band: float
) -> Float[np.ndarray, "n 3"]:
    """Low-pass filter vertices along the surface without shrinking it.

    Positions are filtered by a windowed-sinc polynomial of the umbrella Laplacian K (Taubin,
    Zhang and Golub 1996, Optimal surface smoothing as filter design): it is 1 with zero slope at
    frequency 0, so that the shape is kept, and falls to 0 beyond the pass band. Borders do not
    move.

    Args:
        vertices: Positions, any unit.
        faces: Vertex indices of each triangle.
        pass_band: Frequency k of K (0 to 2) up to which the shape is kept; 2 keeps all.
    """
    if pass_band >= 2.0:
        return vertices
    average, border = _average_matrix(faces, len(vertices))
    weights = _filter_weights(pass_band)
    # Chebyshev recursion over 1 − K, whose eigenvalues are in [−1, 1].
    middle = vertices.mean(axis=0)
    previous = vertices - middle
    current = average @ previous
    result = weights[0] * previous + weights[1] * current
    for weight in weights[2:]:
        previous, current = current, 2.0 * (average @ current) - previous
        result += weight * current
    result += middle
    result[border] = vertices[border]
    return result


def _average_matrix(faces: Int[np.ndarray, "m 3"], num: int) -> tuple[csr_array, np.ndarray]:
    """Matrix 1 − K that averages the neighbors of each vertex, and the border vertices."""
    halves = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    ones = np.ones(len(halves))
    links = coo_array((ones, (halves[:, 0], halves[:, 1])), shape=(num, num)).tocsr()
    both = links + links.T
    open_ends = np.unique((both == 1).nonzero()[0])
    both.data[:] = 1.0
    both.data /= np.repeat(np.diff(both.indptr), np.diff(both.indptr))
    return csr_array(both), open_ends


def _filter_weights(pass_band: float) -> Float[np.ndarray, " n"]:
    """Chebyshev coefficients of the low-pass filter: 1 with zero slope at frequency 0.

    The windowed sinc f is 1 there but has a slope, which shrinks strongly curved regions;
    2 f − f² has neither defect.
    """
    n = np.arange(_DEGREE + 1)
    window = 0.54 + 0.46 * np.cos(n * np.pi / (_DEGREE + 1))
    # f(θ) = 1 for θ below arccos(1 − k): its cosine series.
    edge = np.arccos(np.clip(1.0 - pass_band, -1.0, 1.0))
    weights = np.append(edge / np.pi, 2.0 * np.sin(n[1:] * edge) / (n[1:] * np.pi)) * window
    weights /= weights.sum()
    return chebyshev.chebsub(2.0 * weights, chebyshev.chebmul(weights, weights))


def decimate(mesh: Mesh, edge: float) -> Mesh:
    """Reduce triangles by quadric error (Garland and Heckbert 1997) to a mean edge length [m].

    A mesh that is already coarser is unchanged.

    Raises:
        MissingExtraError: If fast-simplification is not installed.
    """
    fast_simplification = import_extra("fast_simplification", "ct", package="fast-simplification")
    area = triangle_areas(mesh.vertices[mesh.faces]).sum()
    wanted = int(area / (np.sqrt(3.0) / 4.0 * edge**2))
    if wanted >= len(mesh.faces):
        return mesh
    # In millimeters about the middle: the library's tolerances are absolute.
    middle = mesh.vertices.mean(axis=0)
    points, faces = fast_simplification.simplify(
        (mesh.vertices - middle) / MM, mesh.faces.astype(np.int32), target_count=wanted, agg=5.0
    )[:2]
    return Mesh(np.asarray(points, float) * MM + middle, np.asarray(faces, np.int64))
