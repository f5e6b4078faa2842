"""Coverage of a recorded episode: measured from its images, drawn and saved.

`episode_coverage` measures, `coverage_figure` draws, `write_coverage` writes table and mesh.
"""
