"""Organ: a gut wall with centerline, gut coordinates, texture coordinates and appearance.

`surface.OrganSurface` is the data type. `read_organ` reads mesh files and organ files,
`write_organ` writes organ files (GLB), `from_mesh` creates an organ from a wall mesh.
`centerline/`, `gut_coordinates`, `uv` and `uv_charts` compute its coordinates; `measure` measures
it; `cache` stores generated organs on disk.
"""
