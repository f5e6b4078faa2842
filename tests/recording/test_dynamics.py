"""Recording a simulated world: streamed, resumable, with the wall of each frame."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.waiting import wait_until
from vrcaps import _core
from vrcaps.camera_pipeline.capsule_cameras import CapsuleCameras
from vrcaps.camera_pipeline.effect.exposure import AutoExposure
from vrcaps.camera_pipeline.effects import Effects
from vrcaps.core.errors import InputError
from vrcaps.lesion import Location, Polyp
from vrcaps.motion.dynamics import Dynamics
from vrcaps.motion.dynamics_settings import DYNAMICS_COLUMNS
from vrcaps.recording import recorder
from vrcaps.recording.check import check_episode
from vrcaps.recording.episode import read_episode
from vrcaps.recording.recorder import record
from vrcaps.recording.resume import Checkpoint, read_checkpoint, write_checkpoint
from vrcaps.scenario.build import OrganSource, build
from vrcaps.scenario.scenario import Scenario, read_scenario, scenario_from_plain, scenario_to_plain
from vrcaps.tissue.tissue import Drag, WinklerFoundation
from vrcaps.world.schedule import Insufflation, PostureChange, Wrench

MOTION = Dynamics(
    start=0.3,
    motility="steady",
    fallback_segment="jejunum",
    drag=Drag(viscosity=1.0),
    wrenches=(Wrench(force=(0.0, 0.0, 0.05)),),
    wrench_frame="gut",
    posture_changes=(PostureChange("left-lateral", time=0.1, duration=0.25),),
    insufflation=(Insufflation(factor=0.7),),
    settle=0.2,
    substep=1e-3,
)


def digests(folder: Path) -> dict[str, str]:
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in files
    }


def broken_off(scenario: Scenario, out: Path, last: int = 3) -> Checkpoint:
    """Record the first four frames and the checkpoints up to one of them; the last checkpoint."""
    render, reached = CapsuleCameras.begin_capture, []

    def written(folder, checkpoint):
        if checkpoint.motion.frame <= last:
            write_checkpoint(folder, checkpoint)
        reached.append(checkpoint.motion.frame)

    def stopped(images, step):
        if step.index == 4:
            wait_until(lambda: 3 in reached)
            raise KeyboardInterrupt
        return render(images, step)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(recorder, "_CHECKPOINT_SECONDS", 0.0)
        patch.setattr(recorder, "write_checkpoint", written)
        patch.setattr(CapsuleCameras, "begin_capture", stopped)
        with pytest.raises(KeyboardInterrupt):
            record(scenario, out)
    found = read_checkpoint(out)
    assert found is not None
    assert found.motion.frame == last
    return found


def complete_frames(out: Path) -> set[int]:
    """Frames of an episode that have all their files."""
    episode = read_episode(out, unfinished=True)
    return {
        frame
        for frame in range(len(episode))
        if episode.wall_path(frame).exists()
        and all(
            episode.image_path(camera.name, channel, frame).exists()
            for camera in episode.cameras
            for channel in episode.channels
        )
    }


@pytest.fixture
def simulated(scenario: Scenario) -> Scenario:
    return replace(scenario, motion=MOTION, frames=6, fps=10.0, wall=True)


@pytest.fixture(scope="module")
def whole(tmp_path_factory, base_scenario, organ) -> Path:
    """The scenario recorded in one go."""
    given = replace(base_scenario, motion=MOTION, frames=6, fps=10.0, wall=True)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(OrganSource, "load_healthy", lambda _: organ)
        return record(given, tmp_path_factory.mktemp("simulated") / "episode")


@pytest.mark.slow
def test_an_episode_of_physics_is_whole(whole):
    assert check_episode(whole) == []
    names = {path.name for path in whole.iterdir()}
    assert names >= {"wall", "front", "rear", "episode.json", "frames.parquet"}
    assert ".resume" not in names


def test_scenario_round_trip():
    motion = replace(
        MOTION,
        foundation=WinklerFoundation(stiffening_strain=np.inf),
        drag=Drag(law="incetan2021"),
        deformation="rigid",
    )
    given = Scenario(motion=motion)
    text = json.dumps(scenario_to_plain(given), allow_nan=False)
    assert scenario_from_plain(json.loads(text)) == given


@pytest.mark.slow
def test_table_says_what_acted(whole):
    """Newton's second law while the patient lies still: mean forces and gravity make momentum."""
    episode = read_episode(whole)
    columns = episode.table.columns
    assert set(DYNAMICS_COLUMNS) <= set(columns)
    mass, steps = episode.head["capsule"]["mass_kg"], np.diff(columns["time_s"])
    still = [0, 4]  # frames after which nobody turns
    for axis in "xyz":
        force = columns[f"contact_force_{axis}_n"] + columns[f"commanded_force_{axis}_n"]
        gravity = -9.80665 * mass if axis == "z" else 0.0
        impulse = (force[1:] + gravity) * steps
        momentum = mass * np.diff(columns[f"capsule_v{axis}_m_per_s"])
        np.testing.assert_allclose(impulse[still], momentum[still], atol=1e-9)
    commanded = np.stack([columns[f"commanded_force_{a}_n"] for a in "xyz"], axis=1)
    np.testing.assert_allclose(np.linalg.norm(commanded[1:], axis=1), 0.05, rtol=5e-3)
    np.testing.assert_array_equal(columns["insufflation"], 0.7)
    np.testing.assert_array_equal(columns["mmc_phase"], 0)
    patient = episode.table.poses("patient")
    np.testing.assert_allclose(patient[0], episode.head["T_world_patient"], atol=1e-12)
    assert abs(patient[-1] - patient[0]).max() > 0.5
    assert (np.diff(columns["arc_length_m"]) > 0.0).all()  # the force pulls it along


@pytest.mark.slow
def test_stored_wall_is_what_was_rendered(whole):
    """Rays through the pixels meet the stored wall where the episode says."""
    episode = read_episode(whole)
    for frame in (0, 5):
        mesh = episode.wall(frame)
        wall = _core.Wall(mesh.vertices, np.ascontiguousarray(mesh.faces, np.int64))
        points = episode.image("front", "position", frame).reshape(-1, 3)
        seen = np.isfinite(points).all(axis=1)
        nearest = wall.closest_point(points[seen].astype(float))[0]
        assert np.abs(nearest - points[seen]).max() < 1e-6
    assert np.abs(episode.wall(5).vertices - episode.wall(0).vertices).max() > 1e-3
    rest = episode.organ.vertices
    assert episode.wall(0).vertices.shape == rest.shape


@pytest.mark.slow
def test_labels_are_exact_on_the_moving_wall(whole):
    """Against Embree and triangles that carry its hits, as in docs/results/validation.md."""
    from benchmarks.validation.moving_labels import (  # pyright: ignore[reportMissingImports]
        MovingTally,
        compare,
    )

    tally = MovingTally()
    compare(read_episode(whole), tally)
    assert max(tally.moved) > 1e-3
    for name, most in (("depth", 10e-6), ("normal_deg", 0.1), ("flow_px", 0.05), ("back_px", 0.05)):
        errors = np.concatenate(getattr(tally, name))
        assert len(errors) > 1000
        assert np.mean(errors <= most) > 0.999
    for name in ("same_holes", "label", "arc_length", "occlusion"):
        assert np.concatenate(getattr(tally, name)).mean() > 0.999


def test_walls_of_a_fly_through_are_at_rest(scenario, tmp_path):
    given = replace(scenario, frames=2, channels=("depth",), wall=True)
    episode = read_episode(record(given, tmp_path / "e"))
    assert check_episode(episode.path) == []
    np.testing.assert_array_equal(episode.wall(1).vertices, episode.organ.vertices)


@pytest.mark.slow
@pytest.mark.parametrize(("last", "missing"), [(2, None), (3, 1)])
def test_a_broken_off_simulation_goes_on_from_its_checkpoint(
    whole, simulated, tmp_path, monkeypatch, last, missing
):
    """The same bytes; and only what comes after the checkpoint is simulated again."""
    out, rendered = tmp_path / "episode", []
    found = broken_off(simulated, out, last)
    render = CapsuleCameras.begin_capture
    if missing is not None:
        (out / f"wall/{missing:06d}.npy").unlink()
    complete = complete_frames(out)
    assert complete == {0, 1, 2, 3} - {missing}
    times = []

    def counted(images, step):
        rendered.append(step.index)
        return render(images, step)

    monkeypatch.setattr(CapsuleCameras, "begin_capture", counted)
    record(simulated, out, simulated=lambda time, whole: times.append((time, whole)))
    assert digests(out) == digests(whole)
    assert rendered == [frame for frame in range(6) if frame not in complete]
    first = found.motion.frame / 10.0 + 0.2
    assert (min(times)[0] > first) == (missing is None)
    assert max(times) == pytest.approx((0.7, 0.7))


@pytest.mark.slow
def test_automatic_exposure_goes_on_from_a_checkpoint(simulated, tmp_path):
    """The loop's state, the motion and the noise are those of a recording in one go."""
    effects = Effects(auto_exposure=AutoExposure(0.5, target=0.3), motion_blur=2, sensor_noise=2)
    given = replace(simulated, effects=effects, channels=("rgb", "depth"), wall=False)
    straight, broken = record(given, tmp_path / "straight"), tmp_path / "broken"
    exposure = read_episode(straight).table.columns["front_exposure"]
    assert len(set(exposure)) == len(exposure)
    found = broken_off(given, broken)
    times = []
    record(given, broken, simulated=lambda time, _: times.append(time))
    assert min(times) > found.motion.frame / 10.0 + 0.2
    assert digests(broken) == digests(straight)


@pytest.mark.slow
def test_a_whole_episode_is_not_simulated_again(whole, simulated):
    before = digests(whole)
    record(simulated, whole, simulated=lambda *_: pytest.fail("simulated again"))
    (whole / "sheet.png").unlink()
    record(read_scenario(whole / "episode.json"), whole)
    assert digests(whole) == before


@pytest.mark.slow
def test_damaged_checkpoint(simulated, tmp_path):
    out = record(replace(simulated, frames=1), tmp_path / "e")
    (out / "frames.parquet").unlink()
    (out / ".resume").mkdir()
    (out / ".resume" / "index.json").write_text('{"frame": 0}')
    with pytest.raises(InputError, match=r"is damaged .* Delete it to simulate"):
        record(replace(simulated, frames=1), out)


def test_check_finds_faults_of_walls(whole, tmp_path):
    import shutil

    out = Path(shutil.copytree(whole, tmp_path / "e"))
    vertices = np.load(out / "wall/000001.npy")
    (out / "wall/000000.npy").unlink()
    np.save(out / "wall/000001.npy", vertices[:-1])
    (out / "wall/000002.npy").write_bytes(b"no array")
    np.save(out / "wall/000003.npy", np.where(np.arange(len(vertices))[:, None] == 3, np.nan, 1.0))
    np.save(out / "wall/000004.npy", (vertices + 2e-3).astype(np.float32))
    broken = vertices.copy()
    broken[7] = np.nan
    np.save(out / "wall/000005.npy", broken)
    found = {problem.where: problem.what for problem in check_episode(out)}
    assert found["wall/000000.npy"] == "is missing"
    assert "not float32" in found["wall/000001.npy"]
    assert "cannot be read" in found["wall/000002.npy"]
    assert "contains float64" in found["wall/000003.npy"]
    assert "agrees with wall/000004.npy" in found["front/ray_distance/000004.png"]
    assert "not finite" in found["wall/000005.npy"]
    episode = read_episode(out)
    with pytest.raises(InputError, match=r"Cannot read .*000000.npy"):
        episode.wall(0)
    with pytest.raises(InputError, match="has the shape"):
        episode.wall(1)
    with pytest.raises(InputError, match=r"No frame 6 in .* Allowed: 0 to 5"):
        episode.wall(6)


def test_walls_that_were_not_recorded(recorded):
    with pytest.raises(InputError, match=r"contains no walls\. Record it with --wall"):
        read_episode(recorded).wall(0)


@pytest.mark.slow
def test_clean_twin_moves_alike(scenario, tmp_path, monkeypatch):
    """The same motion; and the same wall but where the lesion is."""
    monkeypatch.setenv("VRCAPS_CACHE", str(tmp_path))
    lesions = (Polyp(size=6e-3, location=Location(arc_length=0.12)),)
    motion = replace(MOTION, settle=0.1, start=0.6)
    sick = replace(scenario, motion=motion, lesions=lesions, frames=2)
    twin, clean = build(replace(sick, clean_twin=True))  # lesions are added once for both
    model, run = build(sick)
    far = np.linalg.norm(model.organ.vertices - twin.organ.vertices, axis=1) == 0.0
    assert 0.5 < far.mean() < 1.0
    for one, other in zip(run.steps(), clean.steps(), strict=True):
        np.testing.assert_array_equal(one.state.T_world_capsule, other.state.T_world_capsule)
        gap = one.state.vertices_world - other.state.vertices_world
        np.testing.assert_array_equal(gap[far], 0.0)
        assert np.linalg.norm(gap[~far], axis=1).max() > 2e-3
