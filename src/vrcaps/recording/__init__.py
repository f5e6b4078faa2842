"""Recordings: a scenario rendered to disk as an episode, and read back.

`recorder.record` writes an episode, `episode.read_episode` reads it, `check` verifies it.
`channels` says how each image channel is stored, `table` has the columns of `frames.parquet`,
`layout` the files; `checkpoint` continues an interrupted recording.
"""
