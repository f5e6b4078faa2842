from textured_tube import tube

__all__ = ["tube"]
