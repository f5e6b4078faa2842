"""What `vrcaps bench` measures: rendering against its peers, and recording to disk."""
