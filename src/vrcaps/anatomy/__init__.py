"""Anatomy: generators of healthy organs, each organ's patient drawn from a seed.

`catalog.generate_organ` makes one by name. `colon/`, `stomach/`, `small_bowel/` and `full_tract/`
draw the parameters and the shape of a patient; `tube_mesh/` meshes their walls.
"""
