"""Motility of the gut: rhythm, waves and the migrating motor complex."""
