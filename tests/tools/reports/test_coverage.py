"""Coverage of a recorded episode, by the command line."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import trimesh

from vrcaps.capsule.device_file import read_device
from vrcaps.cli import main
from vrcaps.cli.record import Record
from vrcaps.core.errors import InputError
from vrcaps.metrics.coverage import COVERAGE_LEVELS
from vrcaps.metrics.view_coverage import coverable
from vrcaps.organ.surface import OrganSurface
from vrcaps.recording.episode import read_episode
from vrcaps.recording.recorder import record
from vrcaps.render.channels import CHANNELS
from vrcaps.scenario.scenario import Scenario
from vrcaps.tools.reports.coverage import COVERAGE_CHANNELS, episode_coverage
from vrcaps.world.model import Model


def test_triangles_survive_their_encoding() -> None:
    face = np.array([[-1, 0, 255, 256, 65_535, 65_536, 2**24 - 2]], np.int32)
    encoding = CHANNELS["face"].encoding
    stored = encoding.encode(face)
    assert stored.dtype == np.uint8 and stored.shape == (1, 7, 3)
    assert (encoding.decode(stored) == face).all()
    assert encoding.is_invalid(stored).tolist() == [[True, *[False] * 6]]


def test_flag_adds_channels() -> None:
    chosen = Record(coverage=True).resolved().channels
    assert set(COVERAGE_CHANNELS) <= set(chosen) and len(chosen) == len(set(chosen))


@pytest.mark.slow
def test_recording_with_coverage(scenario: Scenario, tmp_path: Path) -> None:
    out = tmp_path / "run"
    record(replace(scenario, channels=COVERAGE_CHANNELS), out)
    main(["coverage", str(out)])
    main(["check", str(out)])
    table = pq.read_table(out / "coverage" / "coverage.parquet").to_pydict()
    assert len(table["visible"]) == scenario.frames
    for level in COVERAGE_LEVELS:
        assert (np.diff([0.0, *table[level], 1.0]) >= 0.0).all()
    nested = np.array([table[level] for level in COVERAGE_LEVELS[1:]])
    assert (np.diff(nested, axis=0) <= 0.0).all() and nested[0, -1] > 0.1
    mesh = trimesh.load(out / "coverage" / "coverage.glb", force="mesh", process=False)
    episode = read_episode(out)
    assert len(mesh.faces) == episode.head["organ"]["num_faces"]
    level = mesh.vertex_attributes["_COVERAGE"]
    assert set(np.unique(level)) <= {0.0, 1.0, 2.0, 3.0}
    assert (out / "coverage" / "coverage.png").stat().st_size > 10_000
    found = episode_coverage(episode)
    assert table["visible"][-1] == pytest.approx(found.coverage.fraction("visible"))


@pytest.mark.slow
def test_episode_without_triangles_says_what_to_record(recorded: Path) -> None:
    episode = read_episode(recorded)
    plain = [channel for channel in episode.channels if channel != "face"]
    object.__setattr__(episode, "channels", tuple(plain))
    with pytest.raises(InputError, match=r"has no face\. Record it with --coverage"):
        episode_coverage(episode)


def test_coverable_part_grows_with_the_poses(organ: OrganSurface, device_file: Path) -> None:
    model = Model(organ, read_device(device_file))
    few = coverable(model, spacing=0.06, num_offsets=1, num_directions=4, width=24)
    more = coverable(model, spacing=0.03, num_offsets=2, num_directions=16, width=40)
    assert few["visible"].sum() < more["visible"].sum() <= len(organ.faces)
    assert not (more["resolved"] & ~more["visible"]).any()
