"""Benchmarks: speed, validation, appearance, sim-to-real, figures and structure of the code."""
