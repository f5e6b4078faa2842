"""A camera from its frames: circle, vignetting, color, noise, compression."""
