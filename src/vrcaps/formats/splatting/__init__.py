"""Formats for reconstruction and Gaussian splatting: COLMAP, nerfstudio."""
