"""Validation against references, closed forms and independent implementations."""
