"""Tissue: mechanics of the wall.

`tissue.Tissue` collects the mechanical models of one organ: contact with an elastic foundation
(`winkler_foundation`), drag (`drag`), wall deformation by springs (`spring_wall`) or finite
elements (`fem/`), and peristalsis and other contractions (`motility/`).
"""
