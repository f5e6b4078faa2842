"""Observations: what an agent sees, one file each."""
