"""Robot arms that carry a magnet: data files, kinematics, collisions, limits."""
