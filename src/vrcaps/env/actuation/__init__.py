"""Actuation: how an action moves the capsule, one file each."""
