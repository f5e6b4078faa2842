"""Mucosa from a user's own photographs: endoscopic frames to a texture for an organ."""
