"""Tasks: what is to be done in an episode, one file each."""
