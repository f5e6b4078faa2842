"""Overview figures of an organ."""
