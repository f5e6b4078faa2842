"""Reconstruction of a wall from images with depth and poses, and its evaluation.

`fusion` fuses depth images into a surface, with poses that are given or estimated by odometry.
`stitching` combines the images into one and converts it to a surface. `estimates` reads estimated
depth and poses, `compare` measures a surface against the true wall and draws its errors.
"""
