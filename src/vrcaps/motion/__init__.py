"""How the capsule moves: along the centerline, by a recorded path, or by dynamics."""
