"""Device files and the catalog of devices."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from vrcaps.camera.camera import Led, camera_rays, project_points
from vrcaps.camera.lens import LENSES, LensEquirectangular, LensKannalaBrandt, LensPinhole
from vrcaps.capsule.device import Device
from vrcaps.capsule.device_file import device_names, read_device, write_device
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.geometry import invert, rotate_vectors, transform_points
from vrcaps.core.units import MM
from vrcaps.magnet.presets import read_magnet
from vrcaps.magnet.sources import InternalMagnet

DEVICE = """
title = "Mine"
length_mm = 26
radius_mm = 5.5
mass_g = 3.2
frame_rate_hz = 4

[[cameras]]
name = "front"
width_px = 64
height_px = 48
position_mm = [0, 0, 7.1]
rotation = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
exposure_m2_sr_per_w = 0.05

[cameras.lens]
kind = "kannala-brandt"
fx_px = 30
fy_px = 30
cx_px = 31.5
cy_px = 23.5
max_angle_deg = 80

[[cameras.led_rings]]
center_mm = [0, 0, -0.5]
radius_mm = 3
angles_deg = [0, 90, 180, 270]
intensity_mw_per_sr = [2, 1.5, 1]
lobe_exponent = 1
"""


def load_text(tmp_path, text: str) -> Device:
    path = tmp_path / "mine.toml"
    path.write_text(text, encoding="utf-8")
    return read_device(path)


def test_a_users_file_is_read_in_si_units(tmp_path):
    device = load_text(tmp_path, DEVICE)
    assert (device.name, device.title) == ("mine", "Mine")
    assert (device.length, device.radius, device.mass) == (0.026, 0.0055, 0.0032)
    camera = device.cameras[0]
    assert (camera.width, camera.height) == (64, 48)
    np.testing.assert_array_equal(camera.T_capsule_camera[:3, 3], [0.0, 0.0, 0.0071])
    assert camera.lens == LensKannalaBrandt(30, 30, 31.5, 23.5, max_angle=math.radians(80))
    assert camera.leds[0] == Led((0.003, 0.0, -0.0005), intensity=(2e-3, 1.5e-3, 1e-3))
    np.testing.assert_allclose(camera.leds[1].position_camera, [0.0, 0.003, -0.0005], atol=1e-18)


MAGNETS = """
[[magnets]]
position_mm = [0, 0.5, -3]
moment_a_m2 = [0.1, 0, -1.12]

[[magnets]]
position_mm = [0, 0, 2]
preset = "capsule-6x6"
direction = [0, 3, 4]
"""


def test_magnets_are_read_by_moment_or_by_name(tmp_path):
    device = load_text(tmp_path, DEVICE + MAGNETS)
    one, other = device.magnets
    assert one == InternalMagnet((0.0, 0.0005, -0.003), (0.1, 0.0, -1.12))
    moment = read_magnet("capsule-6x6").moment
    np.testing.assert_allclose(other.moment_capsule, [0.0, 0.6 * moment, 0.8 * moment])
    write_device(tmp_path / "mine.toml", device)
    assert read_device(tmp_path / "mine.toml") == device
    assert load_text(tmp_path, DEVICE).magnets == ()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "[0, 0.5, -3]",
            "[0, 0.5, -30]",
            "magnet 0 is outside the body. Allowed: a position",
        ),
        (
            "[0.1, 0, -1.12]",
            "[0, 0, 0]",
            "magnets[0]: An internal magnet has position (0.0, 0.0005",
        ),
        (
            "[0, 3, 4]",
            "[0, 0, 0]",
            "magnets[1]: direction is zero. Allowed: any direction",
        ),
        (
            "capsule-6x6",
            "huge",
            "No magnet named 'huge'. Known: capsule-11x10",
        ),
        (
            "moment_a_m2",
            "moment",
            "magnets[0]: Unknown key moment. Allowed: position_mm with",
        ),
        (
            "direction",
            "way",
            "magnets[1]: Unknown key magnet.way. Allowed: position",
        ),
    ],
)
def test_impossible_magnets(tmp_path, old, new, message):
    assert old in MAGNETS
    with pytest.raises(InputError, match=re.escape(message)):
        load_text(tmp_path, DEVICE + MAGNETS.replace(old, new))


SPECTRUM = """
[led_spectrum]
wavelength_nm = [400, 450.5, 700]
power = [0, 1, 0.25]
"""


def test_spectrum_of_the_leds(tmp_path):
    device = load_text(tmp_path, DEVICE + SPECTRUM)
    assert device.led_spectrum == ((400.0, 0.0), (450.5, 1.0), (700.0, 0.25))
    write_device(tmp_path / "again.toml", device)
    assert replace(read_device(str(tmp_path / "again.toml")), name=device.name) == device


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[400, 450.5, 700]", "[400, 390, 700]", "Allowed: two or more increasing numbers"),
        ("[400, 450.5, 700]", "[400]", "power has 3 values. Allowed: as many as wavelength_nm, 1"),
        ("[0, 1, 0.25]", "[0, 1]", "power has 2 values. Allowed: as many as wavelength_nm, 3"),
        ("[0, 1, 0.25]", "[0, -1, 0.25]", "Allowed: 0 or above, not all 0"),
        ("[0, 1, 0.25]", "[0, 0, 0]", "Allowed: 0 or above, not all 0"),
    ],
)
def test_impossible_spectra(tmp_path, old, new, message):
    with pytest.raises(InputError, match=re.escape(message)):
        load_text(tmp_path, DEVICE + SPECTRUM.replace(old, new))


@pytest.mark.parametrize("name", device_names())
def test_catalog_devices_are_written_and_read_back_equal(tmp_path, name):
    device = read_device(name)
    write_device(tmp_path / f"{name}.toml", device)
    assert read_device(tmp_path / f"{name}.toml") == device
    assert [path.name for path in tmp_path.iterdir()] == [f"{name}.toml"]


@pytest.mark.parametrize("seed", range(5))
def test_any_floats_are_written_and_read_back_equal(tmp_path, seed):
    rng = np.random.default_rng(seed)
    base = load_text(tmp_path, DEVICE)
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    pose = np.eye(4)
    pose[:3, :3] = rotation * np.sign(np.linalg.det(rotation))
    pose[:3, 3] = rng.uniform(-1e-3, 1e-3, 3)
    direction = rng.normal(size=3)
    led = Led(
        tuple(rng.uniform(-1e-3, 1e-3, 3).tolist()),
        tuple((direction / np.linalg.norm(direction)).tolist()),
        tuple(rng.uniform(0, 1e-3, 3).tolist()),
        float(rng.uniform(0, 5)),
    )
    numbers = rng.uniform(20, 30, 4).tolist()
    lenses = (
        LensPinhole(*numbers, *rng.uniform(-1e-7, 1e-3, 6).tolist(), float(rng.uniform(0.1, 1))),
        LensEquirectangular(*numbers, float(rng.uniform(1, 3))),
    )
    cameras = tuple(
        replace(
            base.cameras[0],
            name=lens.kind,
            lens=lens,
            position=tuple(pose[:3, 3].tolist()),
            rotation=tuple(map(tuple, pose[:3, :3].tolist())),
            leds=(led, led),
            exposure=float(rng.uniform(1e-3, 1e3)),
            image_circle_px=float(rng.uniform(10, 30)),
            nominal_field=float(rng.uniform(1, 3)),
        )
        for lens in lenses
    )
    facts = {"lot": 'A "1" \\ µ\n', "seed": seed, "on": True, "gain": [1.5, {"r": 0.1}]}
    device = replace(base, mass=float(rng.uniform(1e-3, 1e-2)), cameras=cameras, metadata=facts)
    write_device(tmp_path / "mine.toml", device)
    assert read_device(tmp_path / "mine.toml") == device


def test_radius_of_the_emitters_of_a_ring(tmp_path):
    ring = """
[[cameras.led_rings]]
center_mm = [0, 0, 0]
radius_mm = 3
angles_deg = [0, 180]
intensity_mw_per_sr = [1, 1, 1]
lobe_exponent = 1
"""
    for line, radius in (("", 0.0), ("emitter_radius_mm = 0.5\n", 0.5e-3)):
        leds = load_text(tmp_path, DEVICE + ring + line).cameras[0].leds
        assert {led.emitter_radius for led in leds[-2:]} == {radius}
    with pytest.raises(InputError, match=r"emitter_radius is -0.0005. Allowed: 0 to 0.005 m"):
        load_text(tmp_path, DEVICE + ring + "emitter_radius_mm = -0.5\n")


def test_led_direction_may_have_any_length(tmp_path):
    led = """
[[cameras.leds]]
position_mm = [1, 2, 3]
direction = [0, 3, 4]
intensity_mw_per_sr = [1, 1, 1]
lobe_exponent = 0
"""
    (first, *_) = load_text(tmp_path, DEVICE + led).cameras[0].leds
    np.testing.assert_allclose(first.direction_camera, [0.0, 0.6, 0.8])


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("length_mm = 26\n", "", "mine.toml: missing key length_mm: a number."),
        ('title = "Mine"', "title = 5", "mine.toml: title is 5. Allowed: a string."),
        ("length_mm = 26", 'length_mm = "26"', "length_mm is '26'. Allowed: a number."),
        ("length_mm = 26", "length_mm = true", "length_mm is True. Allowed: a number."),
        ("length_mm = 26", "length_mm = inf", "length_mm is inf. Allowed: a number."),
        ("length_mm = 26", "length_mm = 1e400", "length_mm is inf. Allowed: a number."),
        ("length_mm = 26", f"length_mm = 1e{'9' * 30}", "is not TOML"),
        ("width_px = 64", "width_px = 99999", "Allowed: a whole number from 1 to 16384."),
        (
            "length_mm = 26",
            "length_mm = 10",
            "length of the capsule, 0.01 m, is below twice",
        ),
        (
            "mass_g = 3.2",
            "mass_g = -3",
            "mine.toml: mass of the capsule is -0.003. Allowed: ab",
        ),
        (
            "mass_g",
            "weight_g",
            "mine.toml: unknown key weight_g. Allowed: length_mm",
        ),
        (
            "mass_g = 3.2",
            "mass_g = 3.2\ncolor = 1",
            "mine.toml: unknown key color. Allowed:",
        ),
        (
            "width_px = 64",
            "width_px = 64.5",
            "cameras[0].width_px is 64.5. Allowed: a whole",
        ),
        ('"front"', '"a/b"', "cameras[0]: Camera's name is 'a/b'. Allowed: letters, digits"),
        ("[0, 0, 7.1]", "[0, 7.1]", "cameras[0].position_mm has 2 values. Allowed: 3."),
        ("[0, 0, 7.1]", "[0, nan, 7.1]", "position_mm[1] is nan. Allowed: a number."),
        ("[0, 0, 7.1]", "[0, 0, 13.1]", "camera 'front' is outside the body."),
        ("[0, 0, 1]]", "[0, 0, 1.1]]", "Allowed: three rows of three numbers, orthonormal"),
        ("[0, 0, 1]]", "[0, 0, -1]]", "orthonormal and right-handed (R_capsule_camera)."),
        ("[0, 0, 1]]", "[0, 0]]", "rotation[2] has 2 values. Allowed: 3."),
        ("[0, 1, 0], [0, 0, 1]]", "[0, 1, 0]]", "rotation has 2 values. Allowed: 3."),
        ("kannala-brandt", "fisheye", "lens.kind is 'fisheye'. Allowed: equidistant, equirect"),
        ("fx_px = 30", "fx = 30", "unknown key cameras[0].lens.fx. Allowed: fx_px, fy_px"),
        ("fx_px = 30", "fx_px = 0", "cameras[0].lens: Lens kannala-brandt: fx = 0.0. Allowed: abo"),
        ("fx_px = 30", "fx_px = nan", "cameras[0].lens.fx_px is nan. Allowed: a number."),
        ("cx_px = 31.5", "cx_px = 64", "lens center cx = 64 px is outside the image. Allowed: -0."),
        ("cy_px = 23.5", "cy_px = -1", "lens center cy = -1 px is outside the image."),
        ("max_angle_deg = 80", "k5 = 1", "unknown key cameras[0].lens.k5. Allowed: fx_px, fy_px"),
        ("max_angle_deg = 80", "max_angle_deg = 200", "max_angle = 3.49"),
        ("cx_px = 31.5", "cx_px = 31.45", "no pixel of the image is in the lens's field."),
        ("[2, 1.5, 1]", "[2, -1, 1]", "intensity is (0.002, -0.001, 0.001). Allowed: 0 or above."),
        ("lobe_exponent = 1", "lobe_exponent = -1", "lobe_exponent is -1.0. Allowed: 0 or above."),
        ("cameras.led_rings", "cameras.led_ring", "Unknown key led_ring. Did you mean led_rings?"),
        (
            "angles_deg = [0, 90, 180, 270]",
            "angles_deg = []",
            "angles is []. Allowed: one or",
        ),
        (
            "[cameras.lens]",
            "[cameras.lens.more]",
            "cameras[0].lens.kind is missing. Allowed",
        ),
        ("[[cameras]]", "[cameras]", "mine.toml: cameras is {'name': 'front'"),
        ("[[cameras.led_rings]]", "[cameras.led_rings]", "cameras[0]: led_rings is {'center_mm'"),
        ("length_mm = 26", "length_mm = ", "The device file "),
    ],
)
def test_what_is_wrong_is_said_in_one_line(tmp_path, old, new, message):
    assert old in DEVICE
    text = DEVICE.replace(old, new)
    if "no pixel" in message:
        text = text.replace("exposure_m2", "image_circle_px = 0.01\nexposure_m2")
    with pytest.raises(InputError, match=re.escape(message)) as caught:
        load_text(tmp_path, text)
    assert "\n" not in str(caught.value)


def test_lens_must_be_a_table(tmp_path):
    start, end = DEVICE.index("[cameras.lens]"), DEVICE.index("[[cameras.led_rings]]")
    text = DEVICE[:start] + 'lens = "kannala-brandt"\n' + DEVICE[end:]
    with pytest.raises(InputError, match=r"lens is 'kannala-brandt'\. Allowed: a table"):
        load_text(tmp_path, text)


def test_angle_that_increases_nowhere(tmp_path):
    start, end = DEVICE.index("kind ="), DEVICE.index("[[cameras.led_rings]]")
    lens = 'kind = "scaramuzza"\na0_px = -70\na2 = 0\na3 = 0\na4 = 0\ncx_px = 31\ncy_px = 23\n'
    with pytest.raises(InputError, match=r"a0 = -70\.0: the angle does not increase"):
        load_text(tmp_path, DEVICE[:start] + lens + DEVICE[end:])


def test_zero_led_direction(tmp_path):
    led = "\n[[cameras.leds]]\nposition_mm = [1, 2, 3]\ndirection = [0, 0, 0]\n"
    led += "intensity_mw_per_sr = [1, 1, 1]\nlobe_exponent = 1\n"
    with pytest.raises(InputError, match=r"direction is .*Allowed: any direction but zero"):
        load_text(tmp_path, DEVICE + led)


def test_led_in_another_unit(tmp_path):
    led = "\n[[cameras.leds]]\nposition_mm = [3600, 0, 0]\nintensity_mw_per_sr = [1, 1, 1]\n"
    with pytest.raises(InputError, match=r"distance of an LED is 3\.6\. Allowed: up to 0\.2 m"):
        load_text(tmp_path, DEVICE + led)


def test_cameras_must_have_different_names(tmp_path):
    cameras = DEVICE[DEVICE.index("[[cameras]]") :]
    with pytest.raises(InputError, match=r"Two cameras share a name \(front, front\)"):
        load_text(tmp_path, DEVICE + cameras)


def test_file_that_is_no_text(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="is not TOML"):
        read_device(path)


def test_file_that_cannot_be_written(tmp_path):
    device = load_text(tmp_path, DEVICE)
    with pytest.raises(InputError, match=r"Cannot write the device file .*: No such file"):
        write_device(tmp_path / "nowhere" / "mine.toml", device)


def test_metadata_that_toml_cannot_hold(tmp_path):
    device = replace(load_text(tmp_path, DEVICE), metadata={"shape": object()})
    with pytest.raises(InputError, match=r"Cannot write .* as TOML: Object of type 'object'"):
        write_device(tmp_path / "other.toml", device)


def test_every_lens_kind_has_a_file_form(tmp_path):
    """A lens is one class and one registry line; files follow from its fields."""
    base = load_text(tmp_path, DEVICE)
    lenses = {
        "pinhole": (30.0, 30.0, 31.5, 23.5),
        "kannala-brandt": (30.0, 30.0, 31.5, 23.5),
        "scaramuzza": (30.0, 0.0, 0.0, 0.0, 31.5, 23.5),
        "equidistant": (30.0, 31.5, 23.5),
        "equirectangular": (30.0, 30.0, 31.5, 23.5),
    }
    for kind, make in LENSES.items():
        camera = replace(base.cameras[0], lens=make(*lenses[kind]))
        write_device(tmp_path / "mine.toml", replace(base, cameras=(camera,)))
        assert read_device(tmp_path / "mine.toml").cameras[0].lens == camera.lens


NAMES = (
    *("dual", "magnetic", "mirocam", "mono"),
    *("panoramic", "pillcam-colon2", "pillcam-sb3", "stereo"),
)
COLONOSCOPE = "colonoscope"  # no capsule: its tip is wider


def test_catalog_names():
    assert device_names() == tuple(sorted((*NAMES, COLONOSCOPE)))


@pytest.mark.parametrize("name", NAMES)
def test_device_is_plausible(name):
    device = read_device(name)
    assert device.name == name
    assert device.title and device.source
    assert 20 * MM < device.length < 35 * MM
    assert 5 * MM < device.radius < 6.5 * MM
    assert 1e-3 < device.mass < 10e-3
    volume = np.pi * device.radius**2 * (device.length - 2.0 / 3.0 * device.radius)
    most = 4000 if device.magnets else 2000
    assert 900 < device.mass / volume < most  # about as dense as water but for a magnet [kg/m³]


@pytest.mark.parametrize("name", NAMES)
def test_lenses_and_leds_are_inside_the_body(name):
    device = read_device(name)
    straight = 0.5 * device.length - device.radius
    for camera in device.cameras:
        assert len(camera.leds) >= 4
        assert {led.emitter_radius for led in camera.leds} == {0.4e-3}
        leds = np.array([led.position_camera for led in camera.leds])
        inside = np.vstack([leds, np.zeros(3)])
        x, y, z = transform_points(camera.T_capsule_camera, inside).T
        radius = np.hypot(np.hypot(x, y), np.maximum(np.abs(z) - straight, 0.0))
        assert np.all(radius < device.radius)


def test_the_colonoscope_sees_as_it_says():
    device = read_device(COLONOSCOPE)
    (camera,) = device.cameras
    assert device.length - 2.0 * device.radius > 0.0
    rays = camera_rays(camera)
    valid = np.isfinite(rays[..., 0])
    assert not valid[0, 0] and valid[0, 160] and valid[144, 0]  # corners are cut, edges are not
    angle = np.degrees(np.arccos(rays[..., 2][valid].min()))
    assert 84.0 < angle <= 85.0


@pytest.mark.parametrize(("name", "expected"), [*((n, 0.4) for n in NAMES), (COLONOSCOPE, 0.416)])
def test_exposure_gives_a_matt_wall_at_20_mm_the_value_stated(name, expected):
    """L = (ρ/π) Σ I cosᵐφ cosα / d², on the axis, with albedo ρ = 0.5."""
    for camera in read_device(name).cameras:
        wall = np.array([0.0, 0.0, 20 * MM])
        irradiance = 0.0
        for led in camera.leds:
            offset = wall - led.position_camera
            distance = np.linalg.norm(offset)
            lobe = max(offset @ led.direction_camera / distance, 0.0) ** led.lobe_exponent
            irradiance += np.array(led.intensity) * lobe * offset[2] / distance**3
        value = camera.exposure * 0.5 / np.pi * irradiance
        np.testing.assert_allclose(value, expected, rtol=1e-3)


@pytest.mark.parametrize("name", ("pillcam-colon2", "dual"))
def test_second_head_looks_back(name):
    front, back = read_device(name).cameras
    ahead = np.array([[0.0, 0.0, 1.0]])
    np.testing.assert_allclose(rotate_vectors(front.T_capsule_camera, ahead), ahead)
    np.testing.assert_allclose(rotate_vectors(back.T_capsule_camera, ahead), -ahead)
    assert back.T_capsule_camera[2, 3] == -front.T_capsule_camera[2, 3]


def test_colon2_has_a_calibration_for_each_head():
    front, back = read_device("pillcam-colon2").cameras
    assert front.lens != back.lens


def test_stereo_baseline_is_along_the_rows_of_both_images():
    left, right = read_device("stereo").cameras
    baseline = right.T_capsule_camera[:3, 3] - left.T_capsule_camera[:3, 3]
    np.testing.assert_allclose(baseline, [3.85 * MM, 0.0, 0.0], atol=1e-12)
    lit = [
        transform_points(c.T_capsule_camera, np.array([led.position_camera for led in c.leds]))
        for c in (left, right)
    ]
    np.testing.assert_allclose(lit[0], lit[1], atol=1e-12)


def test_panorama_has_no_gap_around_the_capsule():
    """Each point on a ring 9 mm about the axis is in the image of a side camera."""
    angle = np.radians(np.arange(360.0))
    ring = np.stack([9 * MM * np.cos(angle), 9 * MM * np.sin(angle), 0 * angle], axis=-1)
    seen = np.zeros(360, int)
    for camera in read_device("panoramic").cameras:
        pixels = project_points(camera, transform_points(invert(camera.T_capsule_camera), ring))
        seen += np.all((pixels > -0.5) & (pixels < 319.5), axis=-1)
        up = invert(camera.T_capsule_camera)[:3, 2]
        np.testing.assert_allclose(up, [0.0, -1.0, 0.0])  # capsule's front is up in the image
    assert seen.min() >= 1
    assert seen.max() == 2


@pytest.mark.parametrize(
    ("name", "share", "across"),
    [("mirocam", 0.862, 126.8), ("pillcam-colon2", 0.737, 142.6), ("pillcam-sb3", 0.786, 155.5)],
)
def test_field_across_the_middle_row(name, share, across):
    """Valid share of the image and angle from the first to the last valid pixel [deg]."""
    rays = camera_rays(read_device(name).cameras[0])
    row = rays[rays.shape[0] // 2]
    row = row[np.isfinite(row[:, 0])]
    ends = np.degrees(np.arccos(row[[0, -1], 2]))
    assert np.isfinite(rays[..., 0]).mean() == pytest.approx(share, abs=1e-3)
    assert ends.sum() == pytest.approx(across, abs=0.1)


def test_unknown_name():
    with pytest.raises(
        UnknownNameError, match=r"No capsule named 'mirocan'\. Known: colonoscope, dual, magnetic"
    ):
        read_device("mirocan")


def test_missing_file(tmp_path):
    with pytest.raises(InputError, match=r"No capsule file at .*mine\.toml.* one of: colonoscope"):
        read_device(tmp_path / "mine.toml")


def test_a_custom_file_is_read_each_time_and_one_of_the_catalog_once(tmp_path):
    assert read_device("mirocam") is read_device("mirocam")
    path = tmp_path / "mirocam.toml"
    write_device(path, replace(read_device("mirocam"), mass=5e-3))
    assert read_device(path).mass == 5e-3
    write_device(path, replace(read_device("mirocam"), mass=6e-3))
    assert read_device(path).mass == 6e-3
    assert read_device("mirocam").mass not in (5e-3, 6e-3)
