"""A gut wall from a CT scan: reading, lumen, surface."""
