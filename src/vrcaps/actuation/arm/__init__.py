"""Arms that carry a magnet: data files, kinematics, collision, motion within limits."""
