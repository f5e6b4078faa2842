"""Runners of a data set's units: this process, a pool of processes, a Ray cluster.

Each is a `Runner` in a separate file. None of them has to run a unit exactly once: a unit is
complete when it is in the ledger, and is not made again.
"""
