"""Policies for the capsule in an environment, baselines and trained ones, and their evaluation.

`policy` defines the protocol of a policy and reads one by name; `registry` lists the baselines.
"""
