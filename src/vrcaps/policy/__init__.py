"""Policies: what moves the capsule in an environment, without learning and learned; their judging.

`policy` says what a policy is and reads one by its name; `registry` lists the baselines.
"""
