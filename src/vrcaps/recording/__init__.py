"""Runs written to disk as episodes, and read back."""
