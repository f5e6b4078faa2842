"""A gut wall as a surface: read, generated, repaired, with its centerline and appearance."""
