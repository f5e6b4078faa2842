"""Comparison of the appearance of two sets of images: `vrcaps compare-looks`.

`views` cuts the same field of view from images of any source and describes each by statistics and
features, `compare` measures distances between sets, and `report` writes them as a page with nearest
images and a blind sheet.
"""
