"""Gut wall as a surface: the common organ type of all sources and consumers, and its arrays."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy

if TYPE_CHECKING:
    from jaxtyping import Float, Int, UInt8, UInt16


@dataclass(frozen=True)
class Centerline:
    """Smooth curve along the middle of a lumen, from the oral to the anal end.

    Attributes:
        points: Samples along the curve [m], in the frame of its surface.
        arc_length: Distance along the curve from the oral end [m], strictly increasing from 0.
        radius: Distance from each sample to the nearest wall [m].
        frames: Rotation at each sample; columns are two transverse axes and the tangent
            (towards the anal end). Parallel transport: no twist about the tangent.
    """

    points: Float[np.ndarray, " n 3"]
    arc_length: Float[np.ndarray, " n"]
    radius: Float[np.ndarray, " n"]
    frames: Float[np.ndarray, " n 3 3"]

    @property
    def length(self) -> float:
        """Length of the curve [m]."""
        return float(self.arc_length[-1])

    @cached_property
    def turns(self) -> Float[np.ndarray, " m 3"]:
        """Rotation vector from each frame to the next, in the former [rad]."""
        relative = np.swapaxes(self.frames[:-1], -1, -2) @ self.frames[1:]
        return scipy.spatial.transform.Rotation.from_matrix(relative).as_rotvec()


def polyline_points(
    centerline: Centerline, arc_length: Float[np.ndarray, "*batch"] | float
) -> Float[np.ndarray, "*batch 3"]:
    """Points [m] at arc lengths [m], interpolated linearly between the samples.

    Much faster than `interpolate`. Arc lengths are clamped to the ends.
    """
    knots = centerline.arc_length
    return np.stack([np.interp(arc_length, knots, axis) for axis in centerline.points.T], axis=-1)


def interpolate(
    centerline: Centerline, arc_length: Float[np.ndarray, "*batch"]
) -> tuple[
    Float[np.ndarray, "*batch 3"], Float[np.ndarray, "*batch 3 3"], Float[np.ndarray, "*batch"]
]:
    """Points [m], frames and radius [m] at any arc lengths along a centerline.

    Points lie on the cubic Hermite curve through the samples and their tangents; frames rotate
    at a constant rate between samples; the radius is linear. Arc lengths are clamped to the ends.

    Args:
        centerline: The curve.
        arc_length: Arc lengths [m]; any shape.
    """
    at = np.clip(arc_length, 0.0, centerline.length)
    knots = centerline.arc_length
    below = np.clip(np.searchsorted(knots, at, side="right") - 1, 0, len(knots) - 2)
    gap = knots[below + 1] - knots[below]
    t = (at - knots[below]) / gap
    start, stop = centerline.points[below], centerline.points[below + 1]
    frames, following = centerline.frames[below], centerline.frames[below + 1]
    pull = (t * (1.0 - t) ** 2 * gap)[..., None] * frames[..., 2]
    pull -= (t**2 * (1.0 - t) * gap)[..., None] * following[..., 2]
    points = start + (t**2 * (3.0 - 2.0 * t))[..., None] * (stop - start) + pull
    partial = scipy.spatial.transform.Rotation.from_rotvec(
        (t[..., None] * centerline.turns[below]).reshape(-1, 3)
    ).as_matrix()
    frames = frames @ partial.reshape(*t.shape, 3, 3)
    return points, frames, np.interp(at, knots, centerline.radius)


CLOSED_RADIUS = "closed_radius_m"
"""Key in the metadata of an organ: mean radius to which its slack wall closes the lumen [m]."""

POCKETS = "pockets"
"""Key in the metadata of an organ: fraction of its length in which gas or fluid keeps a slack lumen
open."""

HEIGHT_STEP = 2.0**-24
"""Quantum of relief [m], 60 nm, so that files store it exactly in 16 bits."""


@dataclass(frozen=True)
class Appearance:
    """Reflectance of the wall, as textures over its texture coordinates.

    The reflectance is the Disney principled model (Burley 2012) without metal or sheen:
    a diffuse base under a rough dielectric, under a clearcoat for the wet film.
    Row 0 of a texture is v = 1 (top), as in image files; u and v wrap.

    Attributes:
        albedo: Base color, sRGB-encoded.
        roughness: Perceptual roughness α^½ of the base, 255 = 1.
        height: Relief of the wall towards the lumen [m]; only its slope is used. Files are
            smallest if it is in multiples of `HEIGHT_STEP` (`round_height`).
        ior: Refractive index of the base's dielectric layer relative to the gas in the lumen.
        clearcoat: Strength of the clearcoat, 0 (dry) to 1 (wet).
        clearcoat_gloss: Gloss of the clearcoat, 0 (satin) to 1 (mirror-like).
    """

    albedo: UInt8[np.ndarray, "h w 3"]
    roughness: UInt8[np.ndarray, "h w"]
    height: Float[np.ndarray, "h w"]
    ior: float = 1.4
    clearcoat: float = 1.0
    clearcoat_gloss: float = 0.9


@dataclass(frozen=True)
class OrganSurface:
    """Gut wall: a triangle surface whose normals point into the lumen.

    Faces are counter-clockwise as seen from the lumen. Positions are in the `patient` frame
    (DICOM LPS, meters) for organs, otherwise in the frame of the mesh file.

    Attributes:
        name: Name of the organ in files and messages.
        vertices: Positions [m].
        faces: Vertex indices of each triangle.
        normals: Unit vertex normals, into the lumen.
        uv: Texture coordinates of each corner of each face.
        label: Segment or tissue class of each vertex, an index into `label_names`.
        label_names: Class names; 0 is `background` (no surface).
        instance: Lesion ID of each vertex, 0 for plain wall.
        arc_length: Gut coordinate of each vertex: distance along the centerline [m].
        theta: Gut coordinate of each vertex: angle around the centerline [rad], −π to π.
        radius: Distance of each vertex from the centerline [m].
        centerline: Reference curve of the gut coordinates.
        appearance: Reflectance; None draws a plain mucosa color.
        metadata: Provenance: generator parameters or source file, seed, repairs.
    """

    name: str
    vertices: Float[np.ndarray, "n 3"]
    faces: Int[np.ndarray, "m 3"]
    normals: Float[np.ndarray, "n 3"]
    uv: Float[np.ndarray, "m 3 2"]
    label: UInt8[np.ndarray, " n"]
    label_names: tuple[str, ...]
    instance: UInt16[np.ndarray, " n"]
    arc_length: Float[np.ndarray, " n"]
    theta: Float[np.ndarray, " n"]
    radius: Float[np.ndarray, " n"]
    centerline: Centerline
    appearance: Appearance | None = None
    metadata: dict = field(default_factory=dict)


def round_height(height: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
    """Round relief [m] to the nearest multiple of `HEIGHT_STEP`."""
    steps = height / HEIGHT_STEP
    np.rint(steps, out=steps)
    steps *= HEIGHT_STEP
    steps += 0.0  # avoid −0
    return steps.astype(np.float32, copy=False)


def clearcoat_alpha(gloss: float) -> float:
    """Roughness α of the clearcoat lobe: 0.1 for gloss 0 to 0.001 for 1 (Burley 2012, 5.4)."""
    return 0.1 + (0.001 - 0.1) * gloss


def face_label(label: Int[np.ndarray, " n"], faces: Int[np.ndarray, "m 3"]) -> np.ndarray:
    """Label of each face: the median of its corners' labels, equal to any majority."""
    return np.median(label[faces], axis=1).astype(label.dtype)


def organ_to_arrays(organ: OrganSurface) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Arrays and plain values of an organ, under ``field`` or ``part.field``."""
    arrays: dict[str, np.ndarray] = {}
    plain: dict[str, Any] = {}
    for prefix, part in (
        ("", organ),
        ("centerline.", organ.centerline),
        ("appearance.", organ.appearance),
    ):
        for f in fields(part) if part is not None else ():
            value = getattr(part, f.name)
            if isinstance(value, np.ndarray):
                arrays[prefix + f.name] = value
            elif f.name not in ("centerline", "appearance"):
                plain[prefix + f.name] = value
    return arrays, plain


def organ_from_arrays(values: Mapping[str, Any]) -> OrganSurface:
    """Reconstruct an organ from the arrays and plain values of `organ_to_arrays`.

    Raises:
        KeyError, TypeError: If a value is missing or unknown.
    """
    parts: dict[str, dict[str, Any]] = {"": {}, "centerline": {}, "appearance": {}}
    for name, value in values.items():
        part, _, field = name.rpartition(".")
        parts[part][field] = value
    organ = parts[""]
    organ["label_names"] = tuple(organ["label_names"])
    appearance = Appearance(**parts["appearance"]) if parts["appearance"] else None
    return OrganSurface(
        **organ, centerline=Centerline(**parts["centerline"]), appearance=appearance
    )


def organ_sha256(organ: OrganSurface) -> str:
    """SHA-256 checksum of an organ's contents, in hexadecimal; the same only for equal organs."""
    arrays, plain = organ_to_arrays(organ)
    types = {name: (array.dtype.str, array.shape) for name, array in sorted(arrays.items())}
    text = json.dumps([types, json_safe(plain)], sort_keys=True)
    digest = hashlib.sha256(text.encode())
    for name in types:
        digest.update(np.ascontiguousarray(arrays[name]).data)
    return digest.hexdigest()


def json_safe(value: Any) -> Any:
    """Convert a value to JSON types: arrays to lists, other objects to text."""
    if isinstance(value, dict):
        return {str(k): json_safe(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [json_safe(v) for v in value]
    if isinstance(value, np.ndarray | np.generic):
        return json_safe(value.tolist())
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value if isinstance(value, bool | int | float | str | None) else str(value)
