"""The Python programs of the pages run, shortened where they would take minutes.

The blocks of a page run in order and share their names. `test_five_jobs` runs the quickstart,
`test_examples` the front page, the tests of each family the guide to extensions, and those of the
bridge its guide.
"""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path

import pytest

from tests.support.coarse_organs import COARSE
from tests.support.programs import run_program

ROOT = Path(__file__).parents[2]
ELSEWHERE = {"README.md", "docs/tutorials/quickstart.md", "docs/how-to/extending.md"}
ELSEWHERE |= {"docs/how-to/connect-a-robot.md"}
NOT_RUN = ("import datasets", "from lerobot", "open_cockpit(")
"""Blocks that need a package which the tests do not install, or a person."""


def episode(name: str, **settings: object) -> str:
    """Statements that record a stomach."""
    return f"""
import vrcaps
vrcaps.record(vrcaps.Scenario("stomach", **{settings!r}), "runs/{name}")
"""


COHORT = '''
from pathlib import Path
Path("plan.toml").write_text("""
frames = 5
channels = ["rgb", "depth"]
organ = {name = "stomach"}
[dataset]
name = "small"
patients = 3
split = {train = 0.4, val = 0.3, test = 0.3}
""")
from vrcaps.cli import main
import sys
sys.argv = ["vrcaps", "dataset", "make", "plan.toml", "--out", "runs/cohort", "--workers", "0"]
try:
    main()
except SystemExit as error:
    assert not error.code
'''
SETUP = {
    "how-to/bring-your-own-hardware.md": """
import os
os.environ["MINARI_DATASETS_PATH"] = os.path.abspath("minari")
""",
    "concepts/coverage.md": episode(
        "stomach", frames=2, channels=("rgb", "ray_distance", "normal", "face")
    ),
    "concepts/datasets.md": COHORT,
    "concepts/effects.md": """
import vrcaps
model = vrcaps.Model(vrcaps.generate_organ("stomach", seed=0), vrcaps.read_device("mirocam"))
renderer, camera, step = vrcaps.Renderer(model), "front", vrcaps.Step(0, model.place())
""",
    "concepts/learning.md": episode("stomach", frames=6, channels=("rgb", "depth"))
    + """
import numpy as np
import vrcaps
sequence = vrcaps.read_episode("runs/stomach").sequence("front")
rng = np.random.default_rng(0)
test_images = train_images = [rng.integers(0, 256, (64, 64, 3), dtype=np.uint8) for _ in range(3)]
pairs = [(t + 0.001, t) for t in 0.02 + 0.02 * rng.random((4, 32, 32))]
patients = [0, 0, 1, 1]
""",
    "how-to/ct.md": """
import numpy as np
import trimesh
from pathlib import Path
from tests.support import phantom
from vrcaps.mesh.mesh import Mesh
gut = trimesh.creation.capsule(0.05, 0.015, count=[30, 30])
gut = Mesh(np.array(gut.vertices), np.array(gut.faces))
scanner = phantom.Scanner(spacing=(1.5e-3, 1e-3, 1e-3))
phantom.write_dicom(Path("dicom"), phantom.scan_of(gut, scanner, np.random.default_rng(0)))
""",
    "reference/episode-format.md": episode(
        "colon", frames=13, wall=True, channels=("rgb", "depth")
    ),
    "reference/formats.md": episode("colon", frames=2, capsule="mono", channels=("rgb", "depth"))
    + COHORT
    + """
from vrcaps.formats import WebDataset, export
export(WebDataset(), vrcaps.data.sequences_of("runs/cohort"), "runs/cohort-wds")
""",
    "reference/conventions.md": 'import shutil\nshutil.copy("DEVICE", "my_capsule.toml")\n',
}
"""Statements before the first block of a page."""
SHORTER = (
    ("range(200)", "range(2)"),
    ("range(20)", "range(2)"),
    ("range(100)", "range(2)"),
    ("learn(100_000)", "learn(32)"),
    (
        'Sb3VecEnv(EnvSettings(organs=("stomach",)), 16)',
        'Sb3VecEnv(EnvSettings(organs=("stomach",)), 2)',
    ),
    ("num_envs=16", "num_envs=2"),
    ("{000000..000004}", "000000"),
    ('read_sources(["runs/cohort"])', 'read_sources(["runs/stomach"])'),
    (
        "TrainSettings(task)",
        'TrainSettings(task, start="scratch", steps=1, batch=1, evaluate_every=1)',
    ),
    ("style=7e-5)", "style=7e-5, size=64)"),
    ('PPO("MultiInputPolicy", envs)', 'PPO("MultiInputPolicy", envs, n_steps=16)'),
)
PAGES = sorted(
    name
    for path in (ROOT / "docs").rglob("*.md")
    if "```python" in path.read_text("utf-8")
    and (name := str(path.relative_to(ROOT))) not in ELSEWHERE
)


def program_of(page: str) -> str:
    """Blocks of a page as one program."""
    text = (ROOT / page).read_text("utf-8")
    blocks = [
        re.sub(rf"(?m)^{match[1]}", "", match[2])
        for match in re.finditer(r"^( *)```python\n(.*?)^ *```$", text, re.MULTILINE | re.DOTALL)
    ]
    runnable = [block for block in blocks if not any(part in block for part in NOT_RUN)]
    program = "\n".join([SETUP.get(page.removeprefix("docs/"), ""), *runnable])
    for old, new in SHORTER:
        program = program.replace(old, new)
    device = ROOT / "src/vrcaps/capsule/devices/mirocam.toml"
    return program.replace("DEVICE", str(device))


@pytest.mark.slow
@pytest.mark.usefixtures("coarse_organs")
@pytest.mark.parametrize("page", PAGES)
def test_the_programs_of_a_page_run(page: str, tmp_path: Path) -> None:
    (tmp_path / "program.py").write_text(program_of(page), encoding="utf-8")
    path = os.pathsep.join([str(ROOT), *sys.path])
    program = tmp_path / "program.py"
    environment = {"PYTHONPATH": path}
    result = run_program(
        program, folder=tmp_path, environment=environment, setup=COARSE, is_loaded=True
    )
    assert result.returncode == 0, result.stderr[-3000:]
