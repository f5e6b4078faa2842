"""Claim: 1,500 images per second of 64 by 64 pixels, color and depth, on two cores in a batch.

Direct light on generated organs at rest, poses along the centerline, the front camera of the
capsule `magnetic` scaled. A batch of `render_batch` and as many `Renderer.render` calls alternate
in one run; the median of rounds. Shadows of six LEDs dominate the time, so both are stated.
Visibility: `ViewCoverage.mark` with 32 by 32 rays, in batches and one by one.

    python -m benchmarks.speed.views [--size ROUNDS]
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.common.scripts import options, table, write_section
from vrcaps import _core
from vrcaps.anatomy.catalog import generate_organ
from vrcaps.camera.derive import scaled_camera
from vrcaps.capsule.device_file import read_device
from vrcaps.metrics.view_coverage import ViewCoverage
from vrcaps.render.batch import render_batch
from vrcaps.render.renderer import Renderer
from vrcaps.render.settings import RenderSettings
from vrcaps.world.model import Model, State

COUNTS = (1, 4, 16, 64, 256)
MOST = 256
CHANNELS = ("rgb", "depth")
LIMIT = 1500.0
HEAD = ("organ", "images", "N", "a batch", "processor time", "one by one", "claimed")
VIEW_HEAD = ("organ", "N", "a batch", "processor time", "one by one")


def alternate(calls: tuple[Callable[[], object], ...], rounds: int) -> list[tuple[float, float]]:
    """Median wall time and processor time [s] of each call; they alternate."""
    taken = np.zeros((rounds, len(calls), 2))
    for call in calls:
        call()
    for k in range(rounds):
        for j, call in enumerate(calls):
            begin = time.perf_counter(), time.process_time()
            call()
            taken[k, j] = time.perf_counter() - begin[0], time.process_time() - begin[1]
    return [(float(wall), float(used)) for wall, used in np.median(taken, axis=0)]


def poses_in(model: Model, count: int) -> np.ndarray:
    """Poses of the capsule along the centerline."""
    return model.centerline_poses(np.linspace(0.05, 0.95, count) * model.organ.centerline.length)


def kind_of(model: Model) -> str:
    """Word for the organ."""
    return f"{model.organ.name}, {len(model.organ.faces):,} triangles"


def image_rows(model: Model, size: int, shadows: bool, rounds: int) -> list[tuple[str, ...]]:
    """Rows of rendering."""
    renderer = Renderer(model, RenderSettings(light="direct", shadows=shadows))
    camera = model.device.cameras[0]
    camera = scaled_camera(camera, size / camera.width)
    rows = []
    for count in COUNTS:
        poses = poses_in(model, count)
        states = [State(0.0, pose) for pose in poses]
        cameras, out = poses @ camera.T_capsule_camera, render_batch([renderer], poses, camera)
        (together, used), (alone, _) = alternate(
            (
                lambda c=cameras, o=out: render_batch([renderer], c, camera, CHANNELS, out=o),
                lambda s=states: [renderer.render(x, camera, channels=CHANNELS) for x in s],
            ),
            max(1, rounds * 16 // max(count, 16)),
        )
        rate = count / together
        kind = f"{size}², {'shadows' if shadows else 'no shadows'}"
        said = (
            ""
            if count < 64 or size != 64
            else f"≥ {LIMIT:,g}/s: {'yes' if rate >= LIMIT else 'NO'}"
        )
        rows.append(
            (kind_of(model), kind, str(count), f"{rate:,.0f}/s", f"{1e6 * used / count:,.0f} µs",
             f"{count / alone:,.0f}/s", said)
        )  # fmt: skip
    return rows


def view_rows(model: Model, rounds: int) -> list[tuple[str, ...]]:
    """Rows of visibility."""
    camera, wall = model.device.cameras[0], [model.wall]
    views, rows = ViewCoverage(camera, width=32), []
    for count in COUNTS:
        poses = poses_in(model, count) @ camera.T_capsule_camera
        flags = np.zeros((count, len(model.organ.faces)), np.uint8)
        (together, used), (alone, _) = alternate(
            (
                lambda p=poses, f=flags: views.mark(wall, p, f),
                lambda p=poses, f=flags: [
                    views.mark(wall, x[None], y[None]) for x, y in zip(p, f, strict=True)
                ],
            ),
            max(1, rounds * 64 // max(count, 64)),
        )
        rows.append(
            (kind_of(model), str(count), f"{count / together:,.0f}/s",
             f"{1e6 * used / count:,.0f} µs", f"{count / alone:,.0f}/s")
        )  # fmt: skip
    return rows


def main() -> None:
    """Measure, write the tables."""
    given = options(__doc__ or "", size=5)
    images, views = [], []
    for kind in ("stomach", "colon"):
        model = Model(generate_organ(kind, seed=21), read_device("magnetic"))
        for size, shadows in ((64, True), (64, False), (32, False)):
            images += image_rows(model, size, shadows, given.size)
        views += view_rows(model, given.size)
    text = f"""## Batched rendering speed

`python -m benchmarks.speed.views`: color and depth by direct light, {_core.num_threads()} threads:

{table(HEAD, images)}

Triangles that 32 by 32 rays see:

{table(VIEW_HEAD, views)}"""
    write_section(given.out, Path(__file__), text)


if __name__ == "__main__":
    main()
