"""Appearance of simulated images compared with real ones."""
