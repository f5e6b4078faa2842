import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from vrcaps.camera_pipeline.effect.exposure import AdaptiveFrameRate, AutoExposure
from vrcaps.camera_pipeline.effect.sensor import BayerFilter
from vrcaps.camera_pipeline.effects import SEVERITIES, Effects
from vrcaps.capsule.device_file import device_of
from vrcaps.motion.fly_through import FlyThrough
from vrcaps.recording.check import check_episode
from vrcaps.recording.episode import read_episode
from vrcaps.recording.recorder import record
from vrcaps.scenario.scenario import Scenario, read_scenario

CHANNELS = ("rgb", "depth", "label")


@pytest.fixture
def degraded(scenario: Scenario) -> Scenario:
    """All effects at severity 2, the camera far too bright at first."""
    effects = Effects(
        **dict.fromkeys(SEVERITIES, 2)
        | {"resolution": 0, "dome_bubbles": 0, "auto_exposure": AutoExposure(0.5, target=0.3)},
        bayer_filter=BayerFilter("grbg"),
    )
    return replace(scenario, effects=effects, channels=CHANNELS)


def images(path: Path) -> list[bytes]:
    return [file.read_bytes() for file in sorted(path.rglob("*.png"))]


@pytest.mark.slow
def test_recorded_effects_change_color_and_lens(
    degraded: Scenario, scenario: Scenario, tmp_path: Path
) -> None:
    out, plain = tmp_path / "out", tmp_path / "plain"
    record(degraded, out)
    record(replace(scenario, channels=CHANNELS), plain)
    episode, ideal = read_episode(out), read_episode(plain)
    assert check_episode(out) == []
    assert episode.cameras[0].lens.kind == "kannala-brandt"
    assert ideal.cameras[0].lens.kind == "equidistant"
    assert set(episode.channels) == set(CHANNELS)
    rgb = episode.image("front", "rgb", 2)
    assert np.abs(rgb.astype(int) - ideal.image("front", "rgb", 2)).mean() > 1.0
    assert np.array_equal(episode.Ts_world_capsule, ideal.Ts_world_capsule)


@pytest.mark.slow
def test_exposure_follows_the_frames_and_is_in_the_table(
    degraded: Scenario, tmp_path: Path
) -> None:
    record(degraded, tmp_path / "out")
    columns = read_episode(tmp_path / "out").table.columns
    automatic = degraded.effects.resolve("auto_exposure")
    for camera in ("front", "rear"):
        exposure, luminance = columns[f"{camera}_exposure"], columns[f"{camera}_luminance"]
        assert luminance[0] == pytest.approx(automatic.target, rel=1e-3)  # it starts settled
        for k in range(len(exposure) - 1):
            assert exposure[k + 1] == automatic.next_exposure(exposure[k], luminance[k], 1.0 / 4.0)
        assert np.ptp(exposure) > 0.0


@pytest.mark.slow
def test_broken_recording_goes_on_to_the_same_bytes(degraded: Scenario, tmp_path: Path) -> None:
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    record(degraded, whole)
    record(degraded, broken)
    head = json.loads((broken / "episode.json").read_text())
    (broken / "episode.json").write_text(json.dumps(head | {"status": "recording"}))
    for frame in (1, 3, 4):
        (broken / "front" / "rgb" / f"{frame:06d}.png").unlink()
    (broken / "frames.parquet").unlink()
    record(degraded, broken)
    assert images(broken) == images(whole)
    assert (broken / "frames.parquet").read_bytes() == (whole / "frames.parquet").read_bytes()


@pytest.mark.slow
def test_color_does_not_depend_on_the_channels_asked_for(
    degraded: Scenario, tmp_path: Path
) -> None:
    record(degraded, tmp_path / "few")
    more = (*CHANNELS, "radiance", "flow_forward", "ray_distance")
    record(replace(degraded, channels=more), tmp_path / "more")
    few, rich = read_episode(tmp_path / "few"), read_episode(tmp_path / "more")
    for frame in range(5):
        assert np.array_equal(few.image("rear", "rgb", frame), rich.image("rear", "rgb", frame))
    assert rich.image("rear", "radiance", 0).max() > 0.0


@pytest.mark.slow
def test_sampled_severities_are_in_the_episode(scenario: Scenario, tmp_path: Path) -> None:
    effects = Effects(sensor_noise=(1, 4), chromatic_aberration=(1, 4))
    asked = replace(scenario, effects=effects, channels=("rgb",), frames=2)
    record(asked, tmp_path / "out")
    sampled = read_scenario(tmp_path / "out" / "episode.json")
    device = device_of(asked.capsule)
    assert sampled.effects == effects.of_device(device).sample(asked.seed)
    record(sampled, tmp_path / "again")
    assert images(tmp_path / "out") == images(tmp_path / "again")


@pytest.mark.slow
def test_adaptive_frame_rate_captures_more_frames_of_a_faster_image(
    scenario: Scenario, tmp_path: Path
) -> None:
    speeds = []
    for name, share in (("slow", 0.2), ("fast", 0.85)):
        motion = FlyThrough(
            start=0.15, end=share, whole=True, speed_variation=0.0, tilt=0.0, drift=0.0
        )
        effects = Effects(
            adaptive_frame_rate=AdaptiveFrameRate(1.0, 8.0, low_motion=0.0, high_motion=0.5)
        )
        asked = replace(scenario, motion=motion, effects=effects, fps=8.0, frames=16)
        record(replace(asked, channels=("depth",)), tmp_path / name)
        columns = read_episode(tmp_path / name).table.columns
        captured, speed = columns["captured"], columns["image_speed_ndc_per_s"]
        assert captured[0] == 1
        last = 0
        for k in range(1, 16):
            assert captured[k] == effects.adaptive_frame_rate.is_due(speed[k], k - last, 8.0)
            last = k if captured[k] else last
        speeds.append((speed.mean(), captured.sum()))
    assert speeds[1][0] > speeds[0][0]
    assert speeds[1][1] > speeds[0][1]
