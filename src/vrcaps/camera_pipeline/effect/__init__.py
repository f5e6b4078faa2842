"""Camera effects: one file each, in the order in which `Effects` lists them.

A `SceneEffect` changes the scene, a `CameraEffect` the camera itself, an `ImageEffect` the image on
its way through lens and sensor, a `TimingEffect` the times of captured frames.
"""
