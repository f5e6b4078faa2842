"""Claim: path tracing is at least 20 times as fast as Cycles.

320 × 320 pixels, 16 paths per pixel, 4 reflections, 2 threads: a generated colon with a matte wall
and six point LEDs, seen by the same pinhole in both; the first frame is not counted. Cycles keeps
its scene, without denoising, adaptive sampling, clamping or its threshold for lights.

Blender is not needed by the package and is not installed with it. Give an interpreter that has it:

    python -m venv BPY && BPY/bin/pip install bpy
    python -m benchmarks.speed.cycles --blender-python BPY/bin/python
"""

from __future__ import annotations

import os
import subprocess
import tempfile
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np

from benchmarks.common.scripts import parser, table, write_section
from benchmarks.speed.path import measure, noise
from benchmarks.validation.path_scenes import FIELD, Scene, scenes
from vrcaps.core.geometry import rotate_vectors, transform_points
from vrcaps.organ.surface import Appearance
from vrcaps.render.renderer import Renderer

THREADS, SAMPLES, DEPTH, IMAGES = 2, 16, 4, 5
LIMIT = 20.0
ALBEDO = (200, 130, 110)
MATT = 64
"""Roughness 1/4: there our diffuse reflectance is Lambert's where light and view coincide."""
HEAD = (
    "", "processor time [s]", "time [s]", "mean radiance", "noise", "of the median pixel",
)  # fmt: skip


def matt_colon(size: int) -> Scene:
    """The generated colon without gloss or film, and its camera."""
    (scene,) = islice(scenes(size), 1, 2)
    color = np.array([[ALBEDO]], np.uint8)
    look = Appearance(
        color, np.full((1, 1), MATT, np.uint8), np.zeros((1, 1)), ior=1.0, clearcoat=0.0
    )
    organ = replace(scene.model.organ, appearance=look)
    return replace(scene, model=replace(scene.model, organ=organ))


def cycles(
    scene: Scene, python: Path, size: int, *, max_bounces: int, images: int
) -> tuple[str, np.ndarray, np.ndarray]:
    """Version, times [images 2] (processor's, wall's, in seconds) and images of Cycles."""
    model, camera = scene.model, scene.camera
    T_world_camera = scene.state.T_world_capsule @ camera.T_capsule_camera
    frame = Renderer(model).render(scene.state, camera, channels=("albedo",))
    with tempfile.TemporaryDirectory() as folder:
        given, made = Path(folder) / "scene.npz", Path(folder) / "images.npz"
        np.savez(
            given,
            size=size, spp=SAMPLES, max_bounces=max_bounces, threads=THREADS, images=images + 1,
            vertices=model.vertices_world,
            normals=rotate_vectors(model.T_world_patient, model.organ.normals),
            faces=model.organ.faces,
            albedo=np.nanmean(frame.albedo, axis=(0, 1)),
            leds=transform_points(
                T_world_camera, np.array([led.position_camera for led in camera.leds])
            ),
            intensities=np.array([led.intensity for led in camera.leds]),
            T_world_camera=T_world_camera,
            field=FIELD,
        )  # fmt: skip
        script = Path(__file__).with_name("cycles_frames.py")
        environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
        command = [str(python), str(script), str(given), str(made)]
        subprocess.run(command, env=environment, check=True, stdout=subprocess.DEVNULL)
        with np.load(made) as found:
            return str(found["version"]), found["times"][1:], found["images"][1:].astype(float)


def main() -> None:
    """Measure, write the table."""
    made = parser(__doc__ or "")
    made.add_argument("--blender-python", type=Path, required=True, help="has bpy")
    made.add_argument("--size", type=int, default=320, help="default 320")
    given = made.parse_args()
    os.environ["RAYON_NUM_THREADS"] = str(THREADS)
    scene = matt_colon(given.size)
    (ours,) = measure([scene.ours(max_bounces=DEPTH, spp=SAMPLES)], images=IMAGES)
    python, size = given.blender_python, given.size
    _, _, first = cycles(scene, python, size, max_bounces=1, images=2)
    same = first.mean() / scene.ours(max_bounces=1, spp=1)(0).mean()
    version, times, images = cycles(scene, python, size, max_bounces=DEPTH, images=IMAGES)
    theirs = (*np.median(times, axis=0), images)
    rows, costs = [], []
    for name, (cpu, wall, frames) in (("ours", ours), (f"Cycles, Blender {version}", theirs)):
        whole, middle = noise(frames)
        costs.append([cpu, wall, cpu * whole**2, cpu * middle**2])
        rows.append((
            name, f"{cpu:.2f}", f"{wall:.2f}", f"{frames.mean():.4f}", f"{whole:.1%}",
            f"{middle:.1%}",
        ))  # fmt: skip
    ratios = np.divide(costs[1], costs[0])
    verdict = "yes" if ratios[1] >= LIMIT else "NO"
    text = (
        "## Rendering speed compared with Cycles\n\n"
        "`python -m benchmarks.speed.cycles --blender-python …`: "
        f"{given.size} × {given.size} pixels, {SAMPLES} paths per pixel, {DEPTH}\nreflections, "
        f"{THREADS} threads, median of {IMAGES} frames after the first, a matte generated colon."
        "\n\n"
        + table(HEAD, rows)
        + f"\n\nCycles' time over ours at equal samples: {ratios[0]:.1f} in processor time, "
        f"{ratios[1]:.1f} in wall-clock time (≥ {LIMIT:g}: {verdict}); at equal\nnoise "
        f"{ratios[2]:.1f}, by the median pixel {ratios[3]:.1f}. The mean radiance of the first "
        f"reflection is {same:.4f} of ours.\nLater ones differ because Cycles' Lambert and our "
        "diffuse reflectance differ between directions of light and view."
    )
    write_section(given.out, Path(__file__), text)


if __name__ == "__main__":
    main()
