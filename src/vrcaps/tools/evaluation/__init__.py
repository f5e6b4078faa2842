"""Output of policy evaluations: figures, an HTML page and videos.

`subject` computes summaries, `summary_figure` and `run_video` draw, `page` writes all to a folder.
"""
