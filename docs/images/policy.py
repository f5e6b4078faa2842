"""Draw four moments of the trained policy in a stomach in which it never learned.

python -m docs.images.policy
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import av
import numpy as np
from PIL import Image

from vrcaps.cli.policy import Evaluate
from vrcaps.tools.reports.evaluation import VIDEO

POLICY, TIME_S = "coverage-ppo", 15.0
MOMENTS = (0.0, 0.14, 0.4, 1.0)
"""Shares of the video."""


def main(path: Path) -> None:
    """Run one episode, then two moments above two."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "run"
        Evaluate(
            (POLICY,), out, organs=("stomach:100",), seeds=1, episodes=1, time=TIME_S,
            dynamics="quasi-static",
        ).run()  # fmt: skip
        with av.open(str(out / POLICY / VIDEO)) as video:
            frames = [frame.to_ndarray(format="rgb24") for frame in video.decode(video=0)]
    cells = [frames[round(share * (len(frames) - 1))] for share in MOMENTS]
    picture = Image.fromarray(np.vstack([np.hstack(cells[:2]), np.hstack(cells[2:])]))
    picture.thumbnail((1400, 1400))
    picture.save(path, quality=88)


if __name__ == "__main__":
    main(Path(__file__).with_suffix(".jpg"))
