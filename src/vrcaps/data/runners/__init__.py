"""What runs the units of a data set: this process, a pool of processes, a Ray cluster.

Each is a `Runner` in a file of its own. None of them needs to run a unit exactly once: a unit
counts when it is in the ledger, and one that is there is not made again.
"""
