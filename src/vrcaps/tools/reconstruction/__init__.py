"""Reconstruction of a wall from images with depth and poses, and its evaluation.

`volume` stores signed distances in blocks, `fuse` fills it from frames and extracts the surface.
`stitch` instead combines the frames into one image, `stitch_surface` converts that to a surface.
`compare` measures a surface against the true wall and draws its errors.
"""
