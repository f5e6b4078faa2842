"""Experiment: pre-training on simulated images for tasks on real images."""
