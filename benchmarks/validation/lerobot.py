"""Claim: LeRobot's own loader reads exported data sets with the recorded values.

Records a capsule that flies and one that a magnet steers, exports both with films and with images,
and reads them by `LeRobotDataset` in the interpreter of a separate environment, for
LeRobot asks for other versions of packages than this project. For example:
``uv venv lerobot && VIRTUAL_ENV=lerobot uv pip install lerobot==0.4.4``, then
``python -m benchmarks.validation.lerobot --python lerobot/bin/python``.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

import vrcaps
from benchmarks.common.scripts import parser, table, write_section
from vrcaps.core.units import CM
from vrcaps.formats.io import export
from vrcaps.formats.robotics.lerobot import LeRobot
from vrcaps.formats.robotics.lerobot_tables import action_rows, state_rows, task_of
from vrcaps.recording.frame_sequence import FrameSequence

_FRAMES, _FPS = 8, 4.0
_LOADER = """
import sys
import numpy, torch
from lerobot.datasets.lerobot_dataset import LeRobotDataset

data = LeRobotDataset("vrcaps/check", root=sys.argv[1], video_backend="pyav")
items = [data[k] for k in range(len(data))]
found = {
    key: torch.stack([item[key] for item in items]).numpy()
    for key in items[0]
    if key != "task"
}
batch = next(iter(torch.utils.data.DataLoader(data, batch_size=4, shuffle=False)))
assert batch["action"].shape[0] == 4
found["tasks"] = numpy.array([item["task"] for item in items])
found["episodes"] = numpy.array(data.num_episodes)
found["state_mean"] = numpy.asarray(data.meta.stats["observation.state"]["mean"])
numpy.savez(sys.argv[2], **found)
"""


def main() -> None:
    """Record, export, read by the loader, compare, write the section."""
    options = parser(__doc__ or "")
    options.add_argument("--python", required=True, help="interpreter that has lerobot")
    given = options.parse_args()
    rows = []
    with tempfile.TemporaryDirectory(prefix="vrcaps-lerobot-") as scratch:
        for name, scenario in scenarios().items():
            episode = vrcaps.read_episode(vrcaps.record(scenario, Path(scratch) / name))
            for images in (False, True):
                out = Path(scratch) / f"{name}-{'images' if images else 'films'}"
                export(LeRobot(images=images), episode.sequences(), out)
                rows.append(_compare(f"{out.name}", _loaded(given.python, out), episode))
    text = table(
        ["export", "frames", "state", "action", "depth", "color [of 255]", "tasks", "claimed"], rows
    )
    head = (
        f"## LeRobot loader\n\n`LeRobotDataset` of lerobot {_version(given.python)}: largest "
        "difference from what was recorded, in float32; for color the mean. Video "
        "compression is lossy.\n\n"
    )
    write_section(given.out, Path(__file__), head + text)


def scenarios() -> dict[str, vrcaps.Scenario]:
    """Scenario of the recording."""
    common = {"frames": _FRAMES, "fps": _FPS, "channels": ("rgb", "depth")}
    stomach = vrcaps.OrganGenerated("stomach", distension="inflated")
    steering = vrcaps.MagnetSteering(
        magnet="cylinder-76.2", arm="panda", standoff=3.0 * CM, wall="upper", speed=1.0 * CM
    )
    motion = vrcaps.Dynamics(start=0.05, magnet=steering, substep=2e-4)
    return {
        "flying": vrcaps.Scenario(organ=stomach, **common),
        "steered": vrcaps.Scenario(organ=stomach, capsule="magnetic", motion=motion, **common),
    }


def _loaded(python: str, folder: Path) -> dict[str, np.ndarray]:
    """Every item of a data set, as returned by the loader."""
    out = folder.with_suffix(".npz")
    environment = {**os.environ, "HF_HUB_OFFLINE": "1", "PYTHONWARNINGS": "ignore"}
    environment.pop("PYTHONPATH", None)
    words = [python, "-c", _LOADER, str(folder), str(out)]
    done = subprocess.run(words, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"The loader fails for {folder.name}:\n{done.stderr[-2000:]}")
    with np.load(out) as found:
        return dict(found)


def _compare(name: str, found: dict[str, np.ndarray], episode: vrcaps.Episode) -> list[str]:
    sequence: FrameSequence = episode.sequence()
    camera = episode.cameras[0].name
    frames = range(len(sequence))
    rgb = np.stack([sequence.image("rgb", k) for k in frames])
    depth = np.stack([sequence.image("depth", k) for k in frames])
    read_rgb = np.moveaxis(found[f"observation.images.{camera}"], 1, -1) * 255.0
    read_depth = found[f"observation.depth.{camera}"]
    errors = {
        "state": np.abs(found["observation.state"] - state_rows(episode).values).max(),
        "action": np.abs(found["action"] - action_rows(episode).values).max(),
        "depth": np.nanmax(np.abs(read_depth - depth)),
    }
    color = np.abs(read_rgb - rgb).mean()
    is_film = name.endswith("films")
    same = (
        max(errors.values()) == 0.0
        and np.array_equal(np.isnan(read_depth), np.isnan(depth))
        and color < (4.0 if is_film else 1e-4)
        and set(found["tasks"]) == {task_of(episode)}
        and np.allclose(found["state_mean"], state_rows(episode).values.mean(axis=0), rtol=1e-4)
        and int(found["episodes"]) == 1
    )
    cells = [f"{error:g}" for error in errors.values()]
    tasks = "as written" if set(found["tasks"]) == {task_of(episode)} else "differ"
    return [name, str(len(rgb)), *cells, f"{color:.3f}", tasks, "yes" if same else "NO"]


def _version(python: str) -> str:
    code = "from importlib.metadata import version; print(version('lerobot'))"
    return subprocess.run(
        [python, "-c", code], capture_output=True, text=True, check=True
    ).stdout.strip()


if __name__ == "__main__":
    main()
