"""Lesions as objects: the wall patch of each, in its own frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import InputError
from vrcaps.core.geometry import (
    Wall,
    invert,
    octahedral_directions,
    transform_from,
    transform_points,
    wall_of,
)
from vrcaps.core.units import MM
from vrcaps.mesh.mesh import vertex_normals
from vrcaps.organ.surface import face_label
from vrcaps.recording.layout import read_stored_organ

if TYPE_CHECKING:
    from jaxtyping import Float, Int

    from vrcaps.recording.episode import Episode

_DIRECTIONS = 48
"""Rows of directions for the search of extreme vertices; 2.6° apart."""
_NEAREST = 1e-4
"""Minimum z of a vertex in front of the camera [m]."""


@dataclass(frozen=True)
class LesionModel:
    """Wall patch of a lesion.

    Attributes:
        object_id: ID of the object in a data set, from 1.
        vertices: Relative to the center of its box, axes of the patient [m].
        faces: Counterclockwise as seen from the lumen.
        center_patient: Center of its box in the patient frame [m].
        wall: Ray-casting scene of the same surface.
    """

    object_id: int
    vertices: Float[np.ndarray, "n 3"]
    faces: Int[np.ndarray, "m 3"]
    center_patient: Float[np.ndarray, " 3"]
    wall: Wall

    @property
    def T_patient_model(self) -> Float[np.ndarray, "4 4"]:
        """Pose in the patient frame [m]."""
        return transform_from(np.eye(3), self.center_patient)

    def ply(self) -> bytes:
        """ASCII PLY in millimeters, with normals that point into the lumen."""
        normals = vertex_normals(self.vertices, self.faces)
        rows = np.concatenate([self.vertices / MM, normals], axis=1)
        columns = [f"property float {name}" for name in ("x", "y", "z", "nx", "ny", "nz")]
        header = ["ply", "format ascii 1.0", f"element vertex {len(rows)}", *columns]
        header += [f"element face {len(self.faces)}", "property list uchar int vertex_indices"]
        lines = [" ".join(f"{value:.6f}" for value in row) for row in rows.tolist()]
        lines += [f"3 {a} {b} {c}" for a, b, c in self.faces.tolist()]
        return "\n".join([*header, "end_header", *lines, ""]).encode()

    def info(self) -> dict[str, float]:
        """Bounding box and diameter [mm], by the keys of BOP's `models_info.json`.

        The diameter is the maximum distance between two vertices that are extreme in any of many
        directions.
        """
        low, high = self.vertices.min(axis=0) / MM, self.vertices.max(axis=0) / MM
        towards = octahedral_directions(_DIRECTIONS).reshape(-1, 3)
        ends = self.vertices[np.unique((self.vertices @ towards.T).argmax(axis=0))] / MM
        diameter = np.linalg.norm(ends[:, None] - ends[None], axis=-1).max()
        return {
            "diameter": float(diameter),
            **{f"min_{axis}": float(low[k]) for k, axis in enumerate("xyz")},
            **{f"size_{axis}": float((high - low)[k]) for k, axis in enumerate("xyz")},
        }

    def depth(
        self,
        T_camera_model: Float[np.ndarray, "4 4"],
        matrix: Float[np.ndarray, "3 3"],
        canvas: tuple[int, int, int, int],
    ) -> tuple[tuple[int, int], Float[np.ndarray, "h w"]] | None:
        """Camera z of its surface alone, NaN elsewhere; None if it is outside the canvas.

        Args:
            T_camera_model: Its pose in the camera frame [m].
            matrix: Camera matrix K [px].
            canvas: First column and row, last column and row [px].

        Returns:
            First column and row of the part of the canvas that it covers, and that part.
        """
        points = transform_points(T_camera_model, self.vertices)
        before = points[:, 2] > _NEAREST
        if not before.any():
            return None
        low, high = np.array(canvas[:2]), np.array(canvas[2:])
        if before.all():  # otherwise its image is unbounded
            pixels = points @ matrix.T
            pixels = pixels[:, :2] / pixels[:, 2:]
            low = np.maximum(low, np.floor(pixels.min(axis=0)).astype(int))
            high = np.minimum(high, np.ceil(pixels.max(axis=0)).astype(int))
        if (low > high).any():
            return None
        columns, rows = (np.arange(low[k], high[k] + 1) for k in (0, 1))
        pixels = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
        homogeneous = np.concatenate([pixels, np.ones((len(pixels), 1))], axis=1)
        rays = homogeneous @ np.linalg.inv(matrix).T  # z is 1, so that distances are depths
        T_model_camera = invert(T_camera_model)
        directions = rays @ T_model_camera[:3, :3].T
        origins = np.broadcast_to(T_model_camera[:3, 3], directions.shape)
        z, _ = self.wall.cast(np.ascontiguousarray(origins), np.ascontiguousarray(directions))
        return (int(low[0]), int(low[1])), z.astype(float).reshape(len(rows), len(columns))


def lesion_models(episode: Episode, first: int) -> Mapping[int, LesionModel]:
    """Models of an episode's lesions by instance ID.

    Args:
        episode: Episode with or without lesions.
        first: ID of the first model.

    Raises:
        InputError: If the stored organ has no lesion IDs.
    """
    if not episode.head["organ"].get("lesions"):
        return {}
    mesh = read_stored_organ(episode.files, episode.head)
    if mesh.instance is None:
        raise InputError(f"The organ of {episode.url} has no lesion IDs. Record it again.")
    T_patient_world = invert(np.array(episode.head["T_world_patient"]))
    vertices = transform_points(T_patient_world, mesh.vertices)
    owner = face_label(mesh.instance, mesh.faces)
    models = {}
    for number in np.unique(owner[owner > 0]).tolist():
        used, faces = np.unique(mesh.faces[owner == number], return_inverse=True)
        patch = vertices[used]
        center = 0.5 * (patch.min(axis=0) + patch.max(axis=0))
        faces = faces.reshape(-1, 3)
        own = first + len(models)
        models[number] = LesionModel(
            own, patch - center, faces, center, wall_of(patch - center, faces)
        )
    return models
