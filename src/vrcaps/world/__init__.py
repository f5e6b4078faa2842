"""World: one organ and one capsule, simulated in time.

`model` defines the constants of a run (`Model`) and its variables (`State`). `world.World` is one
world, under the commands of `control` and `schedule`; `batch.WorldBatch` steps and reads many with
the compiled core. `mechanics` holds the state of a world, to which `lumen_dynamics` and
`magnetic_coupling` add contents and magnets; `snapshot` saves and restores it.
"""
