"""Record a labeled run through a custom mesh, then work with the arrays.

    python examples/02_record_your_own_mesh.py --organ colon.ply --unit mm

Without --organ a small phantom is created first: a bent, folded tube, stored in millimeters as by a
printer or a segmentation tool. It needs `pip install 'vrcaps[organs,reports]'`. The same from the
shell:

    vrcaps record --organ colon.ply --unit mm --frames 30 --out runs/own-mesh
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import trimesh

import vrcaps
from vrcaps._core import Wall
from vrcaps.core.geometry import transform_points


def make_phantom(path: Path) -> None:
    """Write a tube of 40 mm with ring folds, bent by a right angle, as STL in mm."""
    angle, theta = np.meshgrid(
        np.linspace(0.0, np.pi / 2.0, 240), np.linspace(0.0, 2.0 * np.pi, 64, endpoint=False)
    )
    ring = np.maximum(np.cos(24.0 * angle), 0.0) ** 8
    radius = 20.0 - 6.0 * ring * (1.0 + 0.3 * np.cos(3.0 * theta))
    reach = 120.0 + radius * np.cos(theta)
    points = np.stack([reach * np.cos(angle), radius * np.sin(theta), reach * np.sin(angle)], -1)
    rows, columns = angle.shape
    row, column = (a.ravel() for a in np.mgrid[:rows, : columns - 1])
    a, b = row * columns + column, (row + 1) % rows * columns + column
    faces = np.concatenate([np.stack([a, b, a + 1], 1), np.stack([b, b + 1, a + 1], 1)])
    trimesh.Trimesh(points.reshape(-1, 3), faces, process=False).export(path)


def main(organ: Path | None, unit: str, frames: int, out: Path) -> None:
    """Record, read back, and place the middle depth image in the world."""
    if organ is None:
        out.parent.mkdir(parents=True, exist_ok=True)
        organ, unit = out.parent / "phantom.stl", "mm"
        make_phantom(organ)

    # A scenario contains all settings of the recording; it is saved in the episode.
    scenario = vrcaps.Scenario(
        organ=vrcaps.OrganFile(str(organ), unit=unit),
        capsule="mirocam",
        motion=vrcaps.FlyThrough(whole=True, drift=0.4),
        frames=frames,
        channels=("rgb", "depth", "normal"),
    )
    vrcaps.record(scenario, out)

    # Reading gives arrays in SI units. Here the middle depth image becomes a point cloud.
    episode = vrcaps.read_episode(out)
    for line in episode.head["organ"]["metadata"]["repairs"]:
        print("repaired:", line)
    (camera,) = episode.cameras
    middle = len(episode) // 2
    depth = episode.frame(middle).depth
    rows, columns = np.nonzero(np.isfinite(depth))
    rays = camera.lens.unproject(np.stack([columns, rows], axis=1).astype(float))
    points_camera = rays * (depth[rows, columns] / rays[:, 2])[:, None]
    points_world = transform_points(episode.Ts_world_camera(camera.name)[middle], points_camera)

    wall = Wall(episode.organ.vertices, episode.organ.faces)
    distance = np.abs(wall.signed_distance(points_world))
    print(f"{len(points_world)} points, {1e6 * np.median(distance):.1f} µm from the wall (median).")
    print(f"Look at {out / 'sheet.png'}.")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--organ", type=Path, help="PLY, OBJ, STL or GLB")
    parser.add_argument("--unit", default="mm", help="its length unit: m, cm, mm, or e.g. 5cm")
    parser.add_argument("--frames", type=int, default=30)
    parser.add_argument("--out", type=Path, default=Path("runs/own-mesh"))
    parser.add_argument("--smoke", action="store_true", help="record three frames only")
    args = parser.parse_args()
    main(args.organ, args.unit, 3 if args.smoke else args.frames, args.out)
