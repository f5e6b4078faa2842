"""COLMAP models as pycolmap reads them, in a process of its own: its heap is not ours to share."""

import json
import os
import subprocess
import sys
from pathlib import Path

from tests.support.waiting import WATCHDOG


def read_colmap_model(folder: Path) -> dict:
    """Cameras, rigs, points and images of a text model, with points where its cameras show them.

    Args:
        folder: `sparse/0`.

    Returns:
        `models` of the cameras; `num_rigs`, `num_frames`; `points` by number with `xyz` and
        `track_length`; `images` with `id`, `name`, `cam_from_world` and `observed`: rows of the
        point's number, its place in the list, and its place by pycolmap's own projection.
    """
    done = subprocess.run(
        [sys.executable, __file__, str(folder)],
        capture_output=True, text=True, timeout=WATCHDOG, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def _main(folder: str) -> dict:
    import numpy as np
    import pycolmap

    model = pycolmap.Reconstruction(folder)
    points = {
        number: {"xyz": point.xyz.tolist(), "track_length": point.track.length()}
        for number, point in model.points3D.items()
    }
    images = []
    for image in model.images.values():
        camera, pose = model.cameras[image.camera_id], image.cam_from_world()
        seen = [each for each in image.points2D if each.has_point3D()]
        xyz = np.array([points[each.point3D_id]["xyz"] for each in seen]).reshape(-1, 3)
        at = [camera.img_from_cam(pose * row) for row in xyz]
        rows = [
            [each.point3D_id, *each.xy.tolist(), *there.tolist()]
            for each, there in zip(seen, at, strict=True)
        ]
        matrix = pose.matrix().tolist()
        images.append(
            {
                "id": image.image_id, "name": image.name,
                "cam_from_world": matrix, "observed": rows,
            }
        )  # fmt: skip
    cameras = [camera.model.name for camera in model.cameras.values()]
    counts = {"num_rigs": model.num_rigs(), "num_frames": model.num_frames()}
    return {"models": cameras, **counts, "points": points, "images": images}


if __name__ == "__main__":
    text = json.dumps(_main(sys.argv[1]))
    sys.stdout.write(text)
    sys.stdout.flush()
    os._exit(0)  # pycolmap may hang where other libraries end with it
