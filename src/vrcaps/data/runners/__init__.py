"""Runners of a data set's units: this process, a pool of processes, a Ray cluster.

`local.Runner` is their protocol. None of them must run a unit exactly once, since a unit in the
ledger is not made again.
"""
