"""Simulation of a drive: its thread, input, files, coverage and live images."""
