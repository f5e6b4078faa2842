"""A device made in Python is checked as one from a file."""

from dataclasses import replace

import numpy as np
import pytest

import vrcaps
from vrcaps.camera.camera import default_exposure
from vrcaps.capsule.device_file import write_device
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import transform_from
from vrcaps.magnet.sources import InternalMagnet

DEVICE = vrcaps.Device(
    length=24e-3,
    radius=5.5e-3,
    mass=3e-3,
    cameras=(
        vrcaps.Camera(
            "front",
            lens=vrcaps.LensEquidistant(focal=84, cx=127.5, cy=127.5),
            width=256,
            height=256,
            position=(0, 0, 7e-3),
            leds=vrcaps.led_ring(4, radius=3.5e-3),
        ),
    ),
)
CAMERA = DEVICE.cameras[0]


def test_a_capsule_in_one_expression(tmp_path):
    np.testing.assert_allclose(CAMERA.T_capsule_camera, transform_from(np.eye(3), [0, 0, 7e-3]))
    positions = [led.position_camera for led in CAMERA.leds]
    expected = [[3.5e-3, 0, 0], [0, 3.5e-3, 0], [-3.5e-3, 0, 0], [0, -3.5e-3, 0]]
    np.testing.assert_allclose(positions, expected, atol=1e-18)
    write_device(tmp_path / "custom.toml", DEVICE)
    assert vrcaps.read_device(tmp_path / "custom.toml") == DEVICE


def test_default_exposure_is_that_of_the_catalog():
    """A matte wall of albedo 0.5, 20 mm in front, has the value 0.4."""
    for name in set(vrcaps.device_names()) - {"colonoscope"}:  # its light is assumed otherwise
        for camera in vrcaps.read_device(name).cameras:
            assert default_exposure(camera.leds) == pytest.approx(camera.exposure, rel=1e-3)
    assert CAMERA.exposure == default_exposure(CAMERA.leds)
    assert vrcaps.Camera("dark", CAMERA.lens, 256, 256).exposure == 1.0


def test_a_camera_at_another_pose(rng):
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    pose = transform_from(rotation * np.sign(np.linalg.det(rotation)), [1e-3, 0, 0])
    np.testing.assert_array_equal(CAMERA.at(pose).T_capsule_camera, pose)
    assert CAMERA.at(CAMERA.T_capsule_camera) == CAMERA


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"length": 0.0}, "length of the capsule is 0.0. Allowed: above 0 m"),
        ({"length": 10e-3}, "length of the capsule, 0.01 m, is below twice its radius"),
        ({"mass": np.inf}, "mass of the capsule is inf"),
        ({"frame_rate": 0.0}, "frame_rate of the capsule is 0.0"),
        ({"frame_rate": 2.0**31}, "frame_rate of .* is 2147483648.0. Allowed: above 0 to 10000"),
        ({"cameras": ()}, "number of cameras is 0"),
        ({"cameras": (CAMERA, CAMERA)}, r"Two cameras share a name \(front, front\)"),
        ({"cameras": (replace(CAMERA, position=(0, 0, 13e-3)),)}, "camera 'front' is outside"),
        ({"magnets": (InternalMagnet((0, 6e-3, 0), (0, 0, 1)),)}, "magnet 0 is outside"),
        ({"led_spectrum": ((400.0, 1.0),)}, "two or more increasing numbers"),
        ({"led_spectrum": ((400.0, 0.0), (500.0, 0.0))}, "0 or above, not all 0"),
        ({"led_spectrum": ((450.0, 1.0), (460.0, 1.0))}, r"camera's red 0\.0% of the light"),
    ],
)
def test_impossible_devices(change, match):
    with pytest.raises(InputError, match=match):
        replace(DEVICE, **change)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"name": "a/b"}, "Camera's name is 'a/b'. Allowed: letters, digits"),
        ({"name": "capsule"}, "Camera's name is 'capsule'. Allowed: any but capsule, contact"),
        ({"name": "Wall"}, "Camera's name is 'Wall'. Allowed: any but"),
        ({"width": 0}, "'front': width is 0. Allowed: a whole number from 1 to 16384"),
        ({"height": 2.5}, "'front': height is 2.5"),
        ({"rotation": ((1, 0, 0), (0, 1, 0), (0, 0, -1))}, "orthonormal and right-handed"),
        ({"position": (0, 0, np.nan)}, "is not rigid"),
        ({"exposure": 0.0}, "'front': exposure is 0.0. Allowed: above 0"),
        ({"image_circle_px": -1.0}, "'front': image_circle_px is -1.0"),
        ({"width": 100}, "lens center cx = 127.5 px is outside the image"),
        ({"image_circle_px": 0.1}, "no pixel of the image is in the lens's field"),
    ],
)
def test_impossible_cameras(change, match):
    with pytest.raises(InputError, match=match):
        replace(CAMERA, **change)


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: vrcaps.Led((0, 0, 0), (0, 0, 0)), "any direction but zero"),
        (lambda: vrcaps.Led((0, 0, 0), intensity=(1, -1, 1)), "intensity is"),
        (lambda: vrcaps.Led((0, 0, 0), lobe_exponent=-1.0), "lobe_exponent is -1.0"),
        (lambda: vrcaps.Led((0, 0, 0), emitter_radius=-1e-4), "emitter_radius is -0.0001"),
        (lambda: vrcaps.Led((0, 0, 0), emitter_radius=6e-3), "0 to 0.005 m .0 is a point light"),
        (lambda: vrcaps.Led((0, 0, 0), emitter_radius=float("nan")), "emitter_radius is nan"),
        (lambda: vrcaps.led_ring(0, radius=1e-3), "number of LEDs of the ring is 0"),
        (lambda: vrcaps.led_ring(100_000, radius=1e-3), "is 100000. Allowed: 1 to 4096"),
        (lambda: vrcaps.led_ring(4, radius=0.0), "radius of the LED ring is 0.0"),
    ],
)
def test_impossible_leds(make, match):
    with pytest.raises(InputError, match=match):
        make()


def test_direction_of_an_led_may_have_any_length():
    assert vrcaps.Led((0, 0, 0), (0.0, 3.0, 4.0)).direction_camera == (0.0, 0.6, 0.8)
