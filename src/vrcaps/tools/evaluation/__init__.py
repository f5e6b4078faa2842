"""Pictures of how policies were judged: figures, a page and videos.

`subject` sums up, `summary_figure` and `run_video` draw, `page` writes all of it into a folder.
"""
