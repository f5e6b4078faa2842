"""Recordings: render a scenario to disk as an episode and read it back.

`recorder.record` writes an episode, `episode.read_episode` reads it, `check` verifies it.
`channels` defines the encoding of each image channel, `table` the columns of `frames.parquet`,
`layout` the files; `checkpoint` resumes an interrupted recording.
"""
