"""Where to hold a magnet for a wanted wrench, and what holds it there."""
