"""Finite-element layer of the wall."""
