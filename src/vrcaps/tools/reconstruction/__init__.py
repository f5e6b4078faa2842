"""Reconstruction of a wall from images with depth and poses, and its errors.

`volume` holds signed distances in blocks, `fuse` fills it from frames and takes the surface.
`stitch` joins the frames to one image instead, `stitch_surface` makes that a surface. `compare`
measures a surface against the true wall and draws where it errs.
"""
