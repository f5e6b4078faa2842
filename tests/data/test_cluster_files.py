"""The examples of the pages: job files whose slices are the whole data set, and a cohort's plan."""

import os
import re
import subprocess
from pathlib import Path

import pytest

from vrcaps.data.plan import read_plan
from vrcaps.data.units import Units

ROOT = Path(__file__).resolve().parents[2]
SLURM = ROOT / "docs" / "cluster" / "slurm-array.sh"
KUBERNETES = ROOT / "docs" / "cluster" / "kubernetes-job.yaml"
COHORT = ROOT / "examples" / "cohort.toml"


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    """One in which `vrcaps` says what it was given."""
    told = tmp_path / "vrcaps"
    told.write_text('#!/bin/bash\necho "$@"\n')
    told.chmod(0o755)
    return {**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}"}


def slice_of(command: list[str], environment: dict[str, str]) -> tuple[int, int]:
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.startswith("dataset make ")
    found = re.search(r"--units (\d+):(\d+) --workers 4$", done.stdout.strip())
    assert found is not None
    return int(found[1]), int(found[2])


def test_tasks_of_the_slurm_array_make_all_units_once(environment: dict[str, str]) -> None:
    subprocess.run(["bash", "-n", SLURM], check=True)
    last, size = re.findall(r"--array=0-(\d+) .* (\d+)$", SLURM.read_text(), re.MULTILINE)[0]
    slices = [
        slice_of(
            ["bash", str(SLURM), "plan.toml", "/shared/out", size],
            {**environment, "SLURM_ARRAY_TASK_ID": str(task), "SLURM_CPUS_PER_TASK": "4"},
        )
        for task in (0, 1, int(last))
    ]
    assert slices == [(0, 10), (10, 20), (190, 200)]
    assert slices[-1][1] == len(Units(read_plan(COHORT)))


def test_pods_of_the_kubernetes_job_make_all_units_once(environment: dict[str, str]) -> None:
    yaml = pytest.importorskip("yaml", reason="PyYAML is not installed")
    job = yaml.safe_load(KUBERNETES.read_text())
    assert (job["apiVersion"], job["kind"]) == ("batch/v1", "Job")
    assert job["spec"]["completionMode"] == "Indexed"
    (container,) = job["spec"]["template"]["spec"]["containers"]
    given = {item["name"]: item["value"] for item in container["env"]}
    last = job["spec"]["completions"] - 1
    slices = [
        slice_of(
            [*container["command"], *container["args"]],
            {**environment, **given, "JOB_COMPLETION_INDEX": str(pod)},
        )
        for pod in (0, last)
    ]
    assert slices == [(0, 10), (190, 200)]
    assert slices[-1][1] == len(Units(read_plan(COHORT)))


def test_the_cohort_is_a_plan_that_a_person_can_read() -> None:
    assert len(COHORT.read_text().splitlines()) <= 40
    units = Units(read_plan(COHORT))
    assert (len(units), len(units.splits)) == (200, 50)
    scenarios = [units[number].scenario for number in range(len(units))]
    assert {s.capsule for s in scenarios} == {"mirocam", "pillcam-colon2"}
    for patient in range(50):
        own = scenarios[4 * patient : 4 * patient + 4]
        assert len({(s.organ, s.lesions) for s in own}) == 1
        assert [s.clean_twin for s in own] == [False, True, False, True]
    with_lesions = [s for s in scenarios if s.lesions]
    assert {s.organ.name for s in with_lesions} == {"colon"}
    assert len(with_lesions) > 100


def test_the_page_shows_the_cohort() -> None:
    assert COHORT.read_text() in (ROOT / "docs" / "concepts" / "datasets.md").read_text()
