"""Metrics of images, depth, poses and shapes, in pure NumPy."""
