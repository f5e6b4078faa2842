"""What `vrcaps bench` measures: rendering, recording to disk, and the physics."""
