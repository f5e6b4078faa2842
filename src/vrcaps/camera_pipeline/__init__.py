"""Camera pipeline: from scene radiance to the image that a capsule's camera transmits.

Each effect of lens and sensor is one file in `effect/`, with parameters for severities 0 to 4;
`effects.Effects` collects those of a recording and parses them from text.
`pipeline.CameraPipeline` applies them to one camera, `capsule_cameras` to all cameras of a capsule.
"""
