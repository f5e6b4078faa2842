"""Cameras: lens, image, pose in the capsule and LEDs, and the rays of their pixels.

`camera.Camera` is the data type, `lens/` holds the lens models, `rays` tabulates the ray of each
pixel for the renderer, `derive` changes a camera's size or distortion.
"""
