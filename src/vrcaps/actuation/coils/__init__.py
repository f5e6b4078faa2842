"""Coil actuation: arrays of electromagnets, their currents, and the programs that set them."""
