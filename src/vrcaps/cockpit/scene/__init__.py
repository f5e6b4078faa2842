"""Scene: nodes of organ, capsule, magnet, arm and patient, and the colorings of the organ."""
