"""Camera pipeline: from scene radiance to the image that a capsule's camera sends.

Each effect of lens and sensor is one file in `effect/`, with parameters by severity 0 to 4;
`effects.Effects` collects those of a recording, `parse` reads them from text.
`pipeline.CameraPipeline` applies them to one camera, `capsule_cameras` to all of a capsule.
"""
