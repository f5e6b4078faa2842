"""Sensors: a Hall array that finds the capsule, and the inertial unit and magnetometer in it."""
