"""Magnetic field sources, their field and gradient, and the wrench on a capsule's magnets."""
