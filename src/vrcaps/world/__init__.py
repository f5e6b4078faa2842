"""World: one organ and one capsule, simulated in time.

`model` defines the constants of a run (`Model`) and its variables (`State`); `world.World` steps
it with the compiled core under the commands of `control` and `schedule`. `lumen_dynamics`,
`magnetic_coupling` and `fem_coupling` add contents, magnets and elastic walls; `snapshot` saves
and restores the complete state.
"""
