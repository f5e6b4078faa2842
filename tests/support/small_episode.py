"""A small lumen, a small two-headed capsule, and one recorded episode to look at or to break."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.coarse_organs import ATLAS
from tests.support.once import made_once
from tests.support.tubes import textured
from tests.support.write_ply import write_ply
from vrcaps.camera_pipeline.effects import Effects
from vrcaps.mesh.mesh import Mesh
from vrcaps.motion.fly_through import FlyThrough
from vrcaps.organ.read_organ import read_organ
from vrcaps.organ.surface import OrganSurface
from vrcaps.recording.recorder import record
from vrcaps.render.channels import CHANNELS
from vrcaps.scenario.build import OrganSource
from vrcaps.scenario.scenario import OrganFile, Scenario

__all__ = ["base_scenario", "device_file", "mesh_file", "organ", "recorded", "scenario"]
"""The fixtures, for the conftest of a folder that uses them."""

DEVICE = """
title = "Two small cameras"
length_mm = 24
radius_mm = 5.5
mass_g = 3.5
frame_rate_hz = 4
"""
CAMERA = """
[[cameras]]
name = "{name}"
width_px = 40
height_px = 36
position_mm = [0, 0, {z}]
rotation = {rotation}
exposure_m2_sr_per_w = 4

[cameras.lens]
kind = "equidistant"
focal_px = 14
cx_px = 19.5
cy_px = 17.5
max_angle_deg = 70

[[cameras.leds]]
position_mm = [3, 0, 0]
direction = [0, 0, 1]
intensity_mw_per_sr = [1, 1, 1]
lobe_exponent = 1
"""


@pytest.fixture(scope="session")
def device_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("device") / "tiny.toml"
    front = CAMERA.format(name="front", z=11, rotation="[[1, 0, 0], [0, 1, 0], [0, 0, 1]]")
    rear = CAMERA.format(name="rear", z=-11, rotation="[[1, 0, 0], [0, -1, 0], [0, 0, -1]]")
    path.write_text(DEVICE + front + rear)
    return path


@pytest.fixture(scope="session")
def mesh_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tube with round ends, 24 cm long and 4 cm wide."""
    import trimesh

    mesh = trimesh.creation.capsule(height=0.2, radius=0.02, count=[24, 32])
    mesh = mesh.subdivide_to_size(max_edge=0.012)
    path = tmp_path_factory.mktemp("organ") / "tube.ply"
    write_ply(path, Mesh(np.asarray(mesh.vertices), np.asarray(mesh.faces)))
    return path


@pytest.fixture(scope="session")
def organ(mesh_file: Path, tmp_path_factory: pytest.TempPathFactory) -> OrganSurface:
    """The tube with two segments, a lesion and a textured wall; made once for all folders."""
    made = made_once(tmp_path_factory, "small-episode", lambda: _organ(mesh_file))
    return replace(made, metadata={**made.metadata, "source": str(mesh_file)})


def _organ(mesh_file: Path) -> OrganSurface:
    """The organ of a mesh file."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("vrcaps.organ.uv._RESOLUTION", ATLAS)
        plain = read_organ(mesh_file, unit="m")
    half = plain.centerline.length / 2
    marked = replace(
        plain,
        label=np.where(plain.arc_length < half, 1, 2).astype(np.uint8),
        label_names=("background", "upper", "lower"),
        instance=(np.abs(plain.arc_length - 0.8 * half) < 0.01).astype(np.uint16),
    )
    return textured(marked)


@pytest.fixture(scope="session")
def base_scenario(mesh_file: Path, device_file: Path) -> Scenario:
    """All channels of a short flight, at the exposure that the renderer has."""
    return Scenario(
        organ=OrganFile(str(mesh_file), "m"),
        capsule=str(device_file),
        motion=FlyThrough(start=0.15, end=0.85, whole=True),
        frames=5,
        seed=1,
        channels=tuple(CHANNELS),
        effects=Effects.none(),
    )


@pytest.fixture
def scenario(
    base_scenario: Scenario, organ: OrganSurface, monkeypatch: pytest.MonkeyPatch
) -> Scenario:
    """The short flight; the organ is made once for all tests."""
    monkeypatch.setattr(OrganSource, "load_healthy", lambda _: organ)
    return base_scenario


@pytest.fixture(scope="session")
def recorded(
    tmp_path_factory: pytest.TempPathFactory, base_scenario: Scenario, organ: OrganSurface
) -> Path:
    """A whole episode of the scenario; tests that change it work on a copy."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(OrganSource, "load_healthy", lambda _: organ)
        out = tmp_path_factory.mktemp("recorded") / "episode"
        return record(base_scenario, out)
