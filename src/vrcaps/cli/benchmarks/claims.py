"""Speed claims of the project, each with the measurement that it is based on.

The reference values were measured on 2 cores of an AMD EPYC with AVX-512, for one colon of 103,740
triangles at 320 × 320 pixels with the camera inside.
"""

from __future__ import annotations

from vrcaps.cli.benchmarks.report import Claim

RATE = Claim(
    text="complete labeled frames a second, one camera, direct light without shadows",
    sense="≥",
    limit=100.0,
    unit="per second",
    reference="6.0 ms: twice Embree 3's bare primary rays in packets of 16 on both cores, 3.0 ms",
)
PIXELS = Claim(
    text="cost per pixel of a larger image over that of 160 × 160, the worst size",
    sense="≤",
    limit=1.1,
    unit="",
    reference="flat: no dearer than a tenth, the scatter of timings",
)
REFIT = Claim(
    text="refit of 100,000 triangles",
    sense="≤",
    limit=1.0,
    unit="ms",
    reference="prototype 0.4 ms; Embree 3 2.8 ms",
)
HEADS = Claim(
    text="both heads of a capsule over the mean of one",
    sense="≤",
    limit=2.1,
    unit="",
    reference="twice, and a twentieth for the second camera's set-up",
)
TO_DISK = Claim(
    text="labeled frames a second to disk, recorded by default",
    sense="≥",
    limit=60.0,
    unit="per second",
    reference="twice a video's rate",
)
QUICK_TO_DISK = Claim(
    text="labeled frames a second to disk with direct light and no shadows",
    sense="≥",
    limit=100.0,
    unit="per second",
    reference="ten hours of a patient's video overnight",
)
COLLAPSED_TO_DISK = Claim(
    text="labeled frames a second to disk, a collapsed small bowel around a moving capsule",
    sense="≥",
    limit=15.0,
    unit="per second",
    reference="five times the rate of a capsule in the small bowel",
)
MEMORY = Claim(
    text="peak memory of the recording process",
    sense="≤",
    limit=1.0,
    unit="GB",
    reference="a laptop that runs other programs",
)
SUBSTEPS = Claim(
    text="substeps a second per core, a capsule resting on a soft wall, the slowest view",
    sense="≥",
    limit=20_000.0,
    unit="per second",
    reference="real time at the default substep of 50 µs",
)
WAVE = Claim(
    text="wave of the muscle, wall and refit in the world and for images, processor time",
    sense="≤",
    limit=2.5,
    unit="ms",
    reference="a sixth of a frame at 60 per second",
)
LIVING_FRAMES = Claim(
    text="rendered and labeled steps of 1/60 s a second, muscle at work, all by default",
    sense="≥",
    limit=60.0,
    unit="per second",
    reference="real time",
)
FINITE_ELEMENTS = Claim(
    text="steps a second of a wall of 20,000 degrees of freedom or more, processor time",
    sense="≥",
    limit=100.0,
    unit="per second",
    reference="the spring wall's rate of frames, with room",
)
