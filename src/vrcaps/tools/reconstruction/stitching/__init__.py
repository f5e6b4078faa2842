"""Stitching of frames into one image, and conversion of the image to a surface."""
