"""Policies for the capsule in an environment, baselines and trained ones, and their evaluation.

`policy` defines the protocol of a policy; `catalog` lists the baselines and reads policies by name.
"""
