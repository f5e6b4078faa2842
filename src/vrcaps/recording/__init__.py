"""Recordings: render a scenario to disk as an episode and read it back.

`recorder.record` writes an episode, `episode.read_episode` reads it, `check` verifies it. `layout`
defines the files, `frame_files` those of a frame, `organ_files` that of the organ, `table` the
columns of `frames.parquet`; `resume` checks and resumes a folder.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
