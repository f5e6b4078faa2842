"""External file formats: written from episodes and data sets, read as frame sequences.

One file each; `registry` lists them, `export` writes any of them.
"""
