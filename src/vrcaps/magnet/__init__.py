"""Magnetic field sources, their field and gradient, and the wrench on a capsule's magnets.

`sources` defines the kinds of magnet, `presets` named ones, `field_map` sampled fields. `field`
sums flux density and gradient over sources; `internal` is the magnet in a capsule.
"""
