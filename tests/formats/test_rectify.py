"""Resampling to a pinhole: against OpenCV, closed forms, and images of the pinhole itself."""

from dataclasses import replace
from math import radians

import cv2
import numpy as np
import pytest

from vrcaps.camera.camera import Camera, in_image, pixel_grid, project_points
from vrcaps.camera.lens import LensEquidistant, LensKannalaBrandt, LensPinhole, LensScaramuzza
from vrcaps.cli import main
from vrcaps.core.color import linear_from_srgb
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import invert, rotation_from_vector, transform_from, transform_points
from vrcaps.formats.rectify import pinhole_camera, rectified, resampled, widest_field
from vrcaps.recording.frame_sequence import CAMERA_POSE, TIME, FrameSequence

FISHEYE = Camera(
    "front",
    LensKannalaBrandt(fx=90.0, fy=91.0, cx=101.0, cy=98.5, k1=-0.05, k2=0.002),
    200,
    196,
    image_circle_px=95.0,
)
MOVED = transform_from(
    rotation_from_vector(np.array([0.02, -0.03, 0.05])), np.array([1e-3, -5e-4, 2e-3])
)


def plane_distance(rays):
    """Distance to the plane x/8 − y/5 + z = 30 mm along unit rays."""
    return 0.03 / (rays @ np.array([0.125, -0.2, 1.0]))


def tube_distance(rays):
    """Distance to a tube of 20 mm radius around the optical axis along unit rays."""
    return 0.02 / np.hypot(rays[..., 0], rays[..., 1])


def seen(camera, distance):
    """Images of a surface that stands still, from two places, in one camera."""
    rays = camera.lens.unproject(pixel_grid(camera.width, camera.height))
    lit = np.isfinite(project_points(camera, rays)[..., 0])
    rays[~lit] = np.nan
    length = distance(rays)
    points = transform_points(invert(MOVED), (rays * length[..., None]).reshape(-1, 3))
    ends = project_points(camera, points).reshape((*rays.shape[:2], 2))
    names = np.where(rays[..., 0] > 0.1, 3, 1)
    rng = np.random.default_rng(1)
    rgb = rng.integers(0, 256, (*lit.shape, 3), np.uint8)
    rgb = cv2.GaussianBlur(rgb, (0, 0), 3.0)
    rgb[~lit] = 0
    return {
        "rgb": rgb,
        "depth": (rays[..., 2] * length).astype(np.float32),
        "ray_distance": length.astype(np.float32),
        "normal": np.where(lit[..., None], np.array([0.0, 0.0, -1.0], np.float32), np.nan),
        "label": np.where(lit, names, 0).astype(np.uint8),
        "face": np.where(lit, names, -1).astype(np.int32),
        "flow_forward": (ends - pixel_grid(camera.width, camera.height)).astype(np.float32),
        "occlusion": lit & ~in_image(camera, ends),
    }


def sequence_of(camera, distance=plane_distance):
    images = seen(camera, distance)
    values = {TIME: np.zeros(1), CAMERA_POSE: np.eye(4)[None]}
    return FrameSequence("made", tuple(images), values, lambda name, _: images[name], camera)


@pytest.fixture(scope="module")
def source():
    return sequence_of(FISHEYE)


def test_color_is_that_of_opencv(source):
    """OpenCV undistorts and interpolates on its own; its weights are steps of 1/32 px."""
    new = rectified(source, radians(90.0))
    lens, pinhole = FISHEYE.lens, new.camera.lens
    K = np.array([[lens.fx, 0, lens.cx], [0, lens.fy, lens.cy], [0, 0, 1]])
    P = np.array([[pinhole.fx, 0, pinhole.cx], [0, pinhole.fy, pinhole.cy], [0, 0, 1]])
    k = np.array([lens.k1, lens.k2, lens.k3, lens.k4])
    size = new.camera.width, new.camera.height
    maps = cv2.fisheye.initUndistortRectifyMap(K, k, np.eye(3), P, size, cv2.CV_32FC1)
    light = linear_from_srgb(source.image("rgb", 0)).astype(np.float32)
    expected = cv2.remap(light, *maps, cv2.INTER_LINEAR)
    pixels = project_points(FISHEYE, pinhole.unproject(pixel_grid(*size)))
    inner = np.hypot(*np.moveaxis(pixels - (lens.cx, lens.cy), -1, 0)) < 93.0
    found = linear_from_srgb(new.image("rgb", 0))
    steepest = max(np.abs(np.diff(light, axis=axis)).max() for axis in (0, 1))
    assert inner.mean() > 0.9
    # Half a step of the byte where its linear value changes most, and of the weights.
    tolerance = 0.5 * np.diff(linear_from_srgb(np.arange(256))).max() + steepest / 32
    assert np.abs(found - expected)[inner].max() <= tolerance


@pytest.mark.parametrize(("surface", "error"), [(plane_distance, 1e-4), (tube_distance, 1e-3)])
@pytest.mark.parametrize("lens", ["kannala-brandt", "scaramuzza"])
def test_distances_are_those_of_the_pinhole_itself(surface, error, lens):
    """Interpolation of inverse distances errs by 1/8 of their second difference.

    On a plane 1/t is linear in the unit ray, which bends by about 1/f² = 1.2e-4 a pixel along rows
    and columns; in a tube 1/t is sin θ, whose circles bend.
    Within 5° of a tube's axis the wall is seen too obliquely and takes the nearest pixel's value.
    """
    curved = LensScaramuzza(cx=100.3, cy=98.0, a0=80.0, a2=-4e-3, a3=1e-5, a4=-5e-8)
    camera = FISHEYE if lens == "kannala-brandt" else Camera("front", curved, 200, 196)
    new = rectified(sequence_of(camera, surface), radians(80.0))
    true = seen(new.camera, surface)
    rays = new.camera.lens.unproject(pixel_grid(new.camera.width, new.camera.height))
    outer = np.hypot(rays[..., 0], rays[..., 1]) > np.sin(radians(8.0))
    part = outer if surface is tube_distance else np.ones_like(outer)
    for name in ("depth", "ray_distance"):
        found = new.image(name, 0)
        assert np.isfinite(found).all()
        np.testing.assert_allclose(found[part], true[name][part], rtol=error)


def test_no_distance_lies_between_two_surfaces():
    def step(rays):
        return np.where(rays[..., 0] > 0.2, 0.05, 0.01)

    new = rectified(sequence_of(FISHEYE, step), radians(80.0))
    found = np.unique(np.round(new.image("ray_distance", 0), 7))
    np.testing.assert_allclose(found, [0.01, 0.05], rtol=1e-6)


def test_flow_is_that_of_the_geometry(source):
    """The vector is that of a point within half an old pixel of the ray, 1.4 new ones at 45°."""
    new = rectified(source, radians(90.0))
    true = seen(new.camera, plane_distance)["flow_forward"]
    found = new.image("flow_forward", 0)
    both = np.isfinite(found[..., 0]) & np.isfinite(true[..., 0])
    steepest = max(np.nanmax(np.abs(np.diff(true, axis=axis))) for axis in (0, 1))
    assert both.mean() > 0.9
    assert steepest < 0.3
    assert np.abs(found - true)[both].max() <= 2.0 * np.sqrt(2.0) * steepest
    assert np.abs(found - true)[both].mean() < 0.1
    assert np.abs(np.mean((found - true)[both], axis=0)).max() < 0.01


def test_what_leaves_the_smaller_view_is_occluded(source):
    new = rectified(source, radians(60.0))
    camera = new.camera
    ends = new.image("flow_forward", 0) + pixel_grid(camera.width, camera.height)
    inside = (ends > 0.5).all(axis=-1) & (ends < (camera.width - 1.5, camera.height - 1.5)).all(-1)
    outside = (ends < -1.5).any(axis=-1) | (ends > (camera.width + 0.5, camera.height + 0.5)).any(
        -1
    )
    hidden = new.image("occlusion", 0)
    assert outside.any()
    assert hidden[outside].all()
    assert not hidden[inside].any()
    without = rectified(source.with_channels(("rgb", "occlusion")), radians(60.0))
    assert without.channels == ("rgb",)


def test_nothing_is_where_the_old_image_saw_nothing(source):
    """The corners of a wide view lie outside the image circle."""
    new = rectified(source, radians(120.0))
    rays = new.camera.lens.unproject(pixel_grid(new.camera.width, new.camera.height))
    blind = np.isnan(project_points(FISHEYE, rays)[..., 0])
    assert 0.02 < blind.mean() < 0.5
    empty = {"rgb": 0, "label": 0, "face": -1, "occlusion": False}
    for name in new.channels:
        values = new.image(name, 0)[blind]
        assert (values == empty[name]).all() if name in empty else np.isnan(values).all()
    assert set(np.unique(new.image("label", 0)[~blind])) <= {0, 1, 3}


def test_pinhole_stays_as_it_is(pinhole_episode):
    sequence = pinhole_episode.sequence()
    centered = Camera("front", LensPinhole(fx=70.0, fy=70.0, cx=99.5, cy=97.5), 200, 196)
    made = sequence_of(centered)
    same = rectified(made, 2.0 * np.arctan(100.0 / 70.0))
    assert (same.camera.width, same.camera.height) == (200, 196)
    np.testing.assert_allclose(same.camera.lens.fx, 70.0, rtol=1e-12)
    own = resampled(sequence, sequence.camera)
    pairs = [(same, made, name) for name in made.channels if name != "flow_forward"]
    pairs += [(own, sequence, name) for name in own.channels]
    for new, old, name in pairs:
        assert new.image(name, 0).tobytes() == old.image(name, 0).tobytes(), name


def test_middle_keeps_its_resolution_and_the_camera_its_place(source):
    new = rectified(source, radians(100.0)).camera
    np.testing.assert_allclose(new.lens.fx, 90.5, rtol=5e-3)
    np.testing.assert_allclose(new.T_capsule_camera, FISHEYE.T_capsule_camera)
    edges = new.lens.unproject(np.array([[-0.5, new.lens.cy], [new.width - 0.5, new.lens.cy]]))
    np.testing.assert_allclose(np.degrees(np.arccos(edges[0] @ edges[1])), 100.0, atol=1e-6)
    assert pinhole_camera(source, radians(100.0), (64, 48)).width == 64


@pytest.mark.parametrize("angle", [0.0, -20.0, 180.0, 200.0, float("nan")])
def test_angle_that_no_pinhole_has(source, angle):
    with pytest.raises(InputError, match=r"Field of view is .*Allowed: above 0 to below 180"):
        rectified(source, radians(angle))


def test_angle_beyond_the_lens_says_how_far_it_sees(source):
    widest = widest_field(FISHEYE)
    rectified(source, widest)
    with pytest.raises(InputError, match=rf"made sees {np.degrees(widest):.1f} degrees .* 150 deg"):
        rectified(source, radians(150.0))
    wide = Camera("front", LensEquidistant(focal=40.0, cx=99.5, cy=99.5), 200, 200)
    assert 2.0 * np.tan(widest_field(wide) / 2.0) > 10.0


def test_images_of_no_or_another_camera(source):
    with pytest.raises(InputError, match="made has no camera"):
        rectified(replace(source, camera=None), radians(60.0))
    with pytest.raises(InputError, match="200 x 196 pixels, its camera 198 x 196"):
        small = replace(FISHEYE, width=198)
        rectified(replace(source, camera=small), radians(40.0)).image("rgb", 0)


def test_command_rectifies_for_a_format_of_pinholes(fisheye_episode, tmp_path, capsys):
    command = ["export", "tum", str(fisheye_episode.path), "--out", str(tmp_path / "t")]
    command += ["--rectify", "70"]
    main(command)
    assert "Wrote 1 sequence, 5 frames" in capsys.readouterr().out.replace("\n", " ")
    with pytest.raises(SystemExit):
        main([*command[:-1], "190"])
    assert "Allowed: above 0 to below 180 degrees" in capsys.readouterr().err
