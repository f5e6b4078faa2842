"""Benchmarks of `vrcaps bench`: rendering, recording to disk, and the physics."""
