"""Organ: a gut wall with centerline, gut coordinates, texture coordinates and appearance.

`surface.OrganSurface` is the data type. `read_organ` reads mesh files and organ files,
`organ_file` writes and reads organ files (GLB). `centerline`, `gut_coordinates`, `uv` and
`uv_charts` compute the coordinates of a wall; `measure` measures it; `cache` stores generated
organs on disk. `segments` is the table of organs, `waves` makes random fields over a wall.
"""
