"""A short gut and a magnetic capsule with a small camera, to drive."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from tests.support.tubes import straight_gut
from vrcaps.actuation.steering_program import MagnetSteering
from vrcaps.camera.derive import scaled_camera
from vrcaps.camera_pipeline.effects import Effects
from vrcaps.capsule.device_file import read_device
from vrcaps.motion.dynamics import Dynamics
from vrcaps.organ.organ_file import write_organ
from vrcaps.scenario.scenario import Scenario


def small_drive(file: Path) -> Scenario:
    """Scenario in a gut that is written to a file.

    The magnet moves freely: an arm is tested where it is.
    """
    write_organ(file, straight_gut({"jejunum": 0.2}, radius=0.014))
    device = read_device("magnetic")
    device = replace(device, cameras=(scaled_camera(device.cameras[0], 0.25),))
    motion = Dynamics(start=0.3, settle=0.2, substep=5e-4, magnet=MagnetSteering())
    return Scenario(
        str(file),
        capsule=device,
        motion=motion,
        fps=10.0,
        channels=("rgb",),
        effects=Effects.none(),  # images equal the renderer's
    )
