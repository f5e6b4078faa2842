"""Magnetic field sources, their field and gradient, and the wrench on a capsule's magnets.

`sources` defines the kinds of magnet, also those in a capsule, `presets` named ones, `field_map`
sampled fields. `field` sums flux density and gradient over sources and traces field lines.
"""
