"""Tissue: mechanics of the wall.

`tissue.Tissue` collects the laws of one organ: elastic foundation contact (`winkler_foundation`),
drag (`drag`), wall deformation by springs (`spring_wall`) or by finite elements (`fem/`), and
peristalsis and other contractions (`motility/`).
"""
