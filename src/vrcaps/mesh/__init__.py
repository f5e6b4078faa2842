"""Triangle meshes: files, repair, edges, refinement and rasterization; independent of anatomy.

`mesh.Mesh` is the data type; `read_mesh` reads PLY, OBJ, STL and glTF (`ply`, `glb`, `polygons`).
`repair/` converts a mesh file to a manifold lumen, `self_intersection` finds self-intersections.
`edges`, `refine`, `rasterize`, `log_map` and `noise` serve the generators, lesions and textures.
"""
