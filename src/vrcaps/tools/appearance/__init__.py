"""Comparison of the appearance of two sets of images: `vrcaps compare-looks`.

`image_set` cuts the same field of view from images of any source, `statistics` and `features`
describe each view, `compare` measures distances between sets, and `report` writes them as a page
with nearest images and a blind sheet.
"""
