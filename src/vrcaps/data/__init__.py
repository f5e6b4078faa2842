"""Data sets: plans of many recordings, their units, and how they are made anywhere exactly once.

`plan` reads a plan, `units` resolves it to recordings, `make` records them with many workers into
a `store`, whose `ledger` says which are whole.
"""
