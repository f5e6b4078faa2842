"""Triangle meshes: files, repair, edges, refinement and rasterization; nothing of a gut in them.

`mesh.Mesh` is the data type; `read_mesh` reads PLY, OBJ, STL and glTF (`ply`, `glb`, `polygons`).
`repair/` makes a manifold lumen of a mesh file, `self_intersection` finds where one cuts itself.
`edges`, `refine`, `rasterize`, `log_map` and `noise` serve the generators, lesions and textures.
"""
