"""Camera effects: one file each, in the order in which `Effects` lists them.

A `SceneEffect` changes what the camera sees, a `CameraEffect` the camera itself, an `ImageEffect`
the image on its way through lens and sensor, a `TimingEffect` which frames are captured.
"""
