"""Episodes to export: one camera of each lens that formats hold."""

from dataclasses import replace

import pytest

from tests.support.small_episode import *  # noqa: F403
from vrcaps.camera.camera import Camera, led_ring
from vrcaps.camera.lens import LensKannalaBrandt, LensPinhole
from vrcaps.capsule.device import Device
from vrcaps.organ.surface import OrganSurface
from vrcaps.recording.episode import Episode, read_episode
from vrcaps.recording.recorder import record
from vrcaps.scenario.build import OrganSource
from vrcaps.scenario.scenario import Scenario

LENSES = {
    "pinhole": LensPinhole(fx=25.0, fy=24.0, cx=20.25, cy=17.5),
    "kannala-brandt": LensKannalaBrandt(fx=14.0, fy=14.5, cx=19.75, cy=17.5, k1=-0.05, k2=0.002),
}
CHANNELS = ("rgb", "depth", "normal", "label", "instance", "flow_backward", "occlusion")


def _record(lens, folder, base: Scenario, organ: OrganSurface) -> Episode:
    camera = Camera("front", lens, 40, 36, position=(0, 0, 7e-3), leds=led_ring(4, radius=3e-3))
    device = Device(length=24e-3, radius=5.5e-3, mass=3e-3, cameras=(camera,))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(OrganSource, "load_healthy", lambda _: organ)
        scenario = replace(base, capsule=device, channels=CHANNELS, fps=4.0)
        return read_episode(record(scenario, folder))


@pytest.fixture(scope="session")
def pinhole_episode(tmp_path_factory, base_scenario, organ) -> Episode:
    """Five frames through a pinhole."""
    folder = tmp_path_factory.mktemp("pinhole") / "tube"
    return _record(LENSES["pinhole"], folder, base_scenario, organ)


@pytest.fixture(scope="session")
def fisheye_episode(tmp_path_factory, base_scenario, organ) -> Episode:
    """Five frames through a fisheye of Kannala and Brandt."""
    folder = tmp_path_factory.mktemp("fisheye") / "tube"
    return _record(LENSES["kannala-brandt"], folder, base_scenario, organ)
