"""Runners of a data set's units: this process, a pool of processes, a Ray cluster.

`local.Runner` is their protocol. None of them has to run a unit exactly once: a unit is
complete when it is in the ledger, and is not made again.
"""
