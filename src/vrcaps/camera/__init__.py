"""Cameras: lens, image, pose in the capsule and LEDs, and the rays of their pixels.

`camera.Camera` is the data type, `camera.camera_rays` the table of its pixels' rays, `lens/`
contains the lens models, `derive` changes a camera's size or distortion.
"""
