"""Scenarios: everything that defines a recording, as one tree of dataclasses.

`scenario.Scenario` is the tree, read from and written to TOML or JSON; `settings` changes it by
path (`--set`); `build` creates the model of the world and the motion from it.
"""
