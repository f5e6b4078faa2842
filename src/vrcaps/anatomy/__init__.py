"""Generators of healthy organs."""
