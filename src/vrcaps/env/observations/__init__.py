"""Observations of an agent, one file each."""
