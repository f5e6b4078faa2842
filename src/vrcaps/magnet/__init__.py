"""Magnetic fields, the wrench on a capsule with magnets in it, and the arm that carries one."""
