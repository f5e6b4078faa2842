"""Mesh files for tests: binary PLY with wedges and labels."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from vrcaps.mesh.mesh import Mesh


def write_ply(path: Path, mesh: Mesh) -> None:
    """Write a mesh as binary PLY in meters, double precision, with its wedges and labels."""
    columns = [(axis, "<f8") for axis in "xyz"]
    columns += [] if mesh.label is None else [("label", "u1")]
    vertex = np.zeros(len(mesh.vertices), columns)
    for axis, values in zip("xyz", mesh.vertices.T, strict=True):
        vertex[axis] = values
    if mesh.label is not None:
        vertex["label"] = mesh.label
    columns = [("count", "u1"), ("corners", "<i4", 3)]
    columns += [] if mesh.uv is None else [("uv_count", "u1"), ("uv", "<f8", 6)]
    face = np.zeros(len(mesh.faces), columns)
    face["count"], face["corners"] = 3, mesh.faces
    if mesh.uv is not None:
        face["uv_count"], face["uv"] = 6, mesh.uv.reshape(-1, 6)
    lines = ["ply", "format binary_little_endian 1.0", "comment unit meter"]
    lines += [f"element vertex {len(vertex)}", *(f"property double {axis}" for axis in "xyz")]
    lines += [] if mesh.label is None else ["property uchar label"]
    lines += [f"element face {len(face)}", "property list uchar int vertex_indices"]
    lines += [] if mesh.uv is None else ["property list uchar double texcoord"]
    header = "\n".join([*lines, "end_header", ""]).encode()
    path.write_bytes(header + vertex.tobytes() + face.tobytes())
