"""Reconstruction of a wall from images with depth and poses, and its errors.

`volume` holds signed distances in blocks, `fuse` fills it from frames and takes the surface,
`compare` measures it against the true wall and draws where it errs.
"""
