"""Overview pictures of an organ."""
