"""Tissue: mechanics of the wall.

`tissue.Tissue` collects the mechanical models of one organ: contact with an elastic foundation,
drag and deformation by springs or finite elements (`fem/`), and peristalsis and other contractions
(`motility/`).
"""
