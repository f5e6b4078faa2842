"""Mucosa textures from a user's own endoscopic photographs."""
