"""Anatomy: generators of healthy organs; a seed defines the patient.

`catalog.generate_organ` generates an organ by name. `colon/`, `stomach/`, `small_bowel/` and
`full_tract/` draw the parameters and the shape of a patient; `tube_mesh/` meshes their walls.
"""
