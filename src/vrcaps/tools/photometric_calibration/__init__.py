"""A camera from its frames: circle, vignetting, colour, noise, compression."""
