"""Scenes, twins of kernels, oracles and fixtures shared by tests and benchmarks."""
