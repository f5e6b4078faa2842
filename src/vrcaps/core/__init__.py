"""Foundations: units, errors, random streams, transforms, geometry, names and files."""
