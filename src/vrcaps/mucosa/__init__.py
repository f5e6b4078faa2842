"""Mucosa: the appearance of the wall, as textures over an organ's texture coordinates.

`mucosa` has the parameters and a preset for each organ, `bake.bake_appearance` bakes one with its
vessels and relief. `texture` reads and writes textures made from photographs,
`apply_texture` applies one to an organ by lapped texturing.
"""
