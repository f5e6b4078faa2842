"""Motions of the capsule: fly-through, random views, replay of a recorded path, and dynamics.

Each kind is one file (`fly_through`, `random_views`, `replay`, `dynamics`) and one line in
`registry`; `motion` has their interface. A motion gives one `step.Step` for each frame, from a
`trajectory` known beforehand or from a `rollout` of the world.
"""
