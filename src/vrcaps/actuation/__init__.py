"""Magnetic actuation: controller, pose solver, actuators, targets and paths."""
