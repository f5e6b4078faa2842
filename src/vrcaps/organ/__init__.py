"""The organ: a gut wall with centerline, gut coordinates, texture coordinates and appearance.

`surface.OrganSurface` is the data type. `read_organ` reads mesh files and organ files,
`write_organ` writes organ files (GLB), `from_mesh` makes an organ of a wall mesh.
`centerline/`, `gut_coordinates`, `uv` and `uv_charts` compute its coordinates; `measure` measures
it; `cache` keeps generated organs on disk.
"""
