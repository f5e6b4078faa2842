"""Triangle meshes: files, repair, refinement and rasterization; independent of anatomy.

`mesh.Mesh` is the data type; `read_mesh` reads PLY, OBJ, STL and glTF (`polygon_files`,
`gltf`).
`repair` converts a mesh file to a manifold lumen, `self_intersection` finds self-intersections and
`untangle` removes them.
`patch`, `rasterize` and `noise` serve the generators, lesions and textures.
"""
