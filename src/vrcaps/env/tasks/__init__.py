"""Tasks of an episode, one file each."""
