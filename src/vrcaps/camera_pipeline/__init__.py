"""Lens and sensor of a real camera: stages with physical parameters, and grades 0 to 4 of each."""
