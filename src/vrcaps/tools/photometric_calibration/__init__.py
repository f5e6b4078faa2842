"""Photometric camera calibration from frames: circle, vignetting, color, noise, compression."""
