from tests.support.textured_tube import tube

__all__ = ["tube"]
