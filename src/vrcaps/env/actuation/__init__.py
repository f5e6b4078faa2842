"""Actuations, which map actions to the capsule's motion, one file each."""
