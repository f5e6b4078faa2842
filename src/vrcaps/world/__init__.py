"""Organ and capsule together: what is fixed, what changes, how the capsule moves."""
