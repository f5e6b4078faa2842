"""The world: one organ and one capsule, stepped in time.

`model` holds what is fixed (`Model`) and what changes (`State`); `world.World` steps it with the
compiled core, under what `control` and `schedule` command. `lumen_dynamics`, `magnetic_coupling`
and `fem_coupling` add contents, magnets and elastic walls; `snapshot` saves and restores it all.
"""
