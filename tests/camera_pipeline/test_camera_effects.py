import numpy as np
import pytest

from tests.support.shapes import DIRECT, LENSES, make_camera, make_model, sphere
from vrcaps.camera.camera import camera_rays, pixel_grid, project_points
from vrcaps.camera.derive import barrel_radius, focal_length_px, scaled_camera
from vrcaps.camera_pipeline.effect.optics import Distortion, FieldOfView
from vrcaps.camera_pipeline.effect.scene import DomeBubbles, SpecularReflection
from vrcaps.camera_pipeline.effect.sensor import Resolution
from vrcaps.capsule.device_file import device_names, read_device
from vrcaps.core.errors import InputError
from vrcaps.organ.surface import Appearance
from vrcaps.render.renderer import Renderer


@pytest.mark.parametrize("name", sorted(LENSES))
@pytest.mark.parametrize("scale", [0.5, 1.6])
def test_scaled_camera_sees_the_same_rays(name: str, scale: float, rng) -> None:
    """Pixel p of the camera is pixel (p + ½) s − ½ of the scaled one."""
    camera = make_camera(name, image_circle_px=35.0)
    scaled = scaled_camera(camera, scale)
    assert (scaled.width, scaled.height) == (
        round(camera.width * scale),
        round(camera.height * scale),
    )
    rays = rng.normal(size=(300, 3)) + np.array([0.0, 0.0, 1.5])
    expected = (project_points(camera, rays) + 0.5) * scale - 0.5
    seen = project_points(scaled, rays)
    assert np.allclose(seen, expected, atol=1e-6, equal_nan=True)


def test_longer_lens_magnifies_about_its_center() -> None:
    camera = make_camera("equidistant")
    longer = FieldOfView(2.0).on(camera)
    rays = camera_rays(longer)[39, 60].astype(float)
    shift = project_points(camera, rays) - (camera.lens.cx, camera.lens.cy)
    assert shift == pytest.approx(((60 - 39.5) / 2.0, (39 - 39.5) / 2.0), abs=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("name", device_names())
@pytest.mark.parametrize("strength", [0.1, 0.4])
def test_barrel_follows_the_division_model(name: str, strength: float) -> None:
    """Within 3 % of half the image's side; the middle grows by 1 / (1 − D)."""
    for camera in read_device(name).cameras:
        bent = Distortion(strength).on(camera)
        edge = 0.5 * min(camera.width, camera.height)
        rays = camera_rays(camera)
        lit = np.isfinite(rays).all(axis=-1)
        center = np.array([camera.lens.cx, camera.lens.cy])
        before = np.hypot(*np.moveaxis(pixel_grid(camera.width, camera.height) - center, -1, 0))
        after = bent.lens.project(rays[lit].astype(float)) - center
        radius = np.hypot(after[:, 0], after[:, 1])
        known = np.isfinite(radius)
        assert known.mean() > 0.99
        drawn = barrel_radius(before[lit], strength, edge)
        assert np.abs(radius - drawn)[known].max() < 0.03 * edge
        assert focal_length_px(bent.lens) == pytest.approx(
            focal_length_px(camera.lens) / (1.0 - strength), rel=1e-6
        )
        assert np.isfinite(camera_rays(bent)).any()


def test_clear_coat_is_what_the_wall_reflects(rng) -> None:
    look = Appearance(
        np.full((8, 8, 3), 120, np.uint8), np.full((8, 8), 128, np.uint8), np.zeros((8, 8))
    )
    from tests.support.shapes import looking

    camera, state = make_camera("pinhole"), looking((0.004, 0.0, 0.002))
    organ = sphere(3, appearance=look)
    images = []
    for coat in (
        SpecularReflection(0.0, ior=1.0),
        SpecularReflection(0.5),
        SpecularReflection(1.0),
    ):
        frame = Renderer(make_model(coat.on_organ(organ), camera), DIRECT).render(
            state, camera, channels=("radiance", "albedo", "normal")
        )
        images.append(np.asarray(frame.radiance))
        if coat.clearcoat == 0.0:
            matt = images[0] / np.asarray(frame.albedo)
            assert np.allclose(matt[..., :1], matt, rtol=1e-3)  # no white light of a mirror
    assert images[0].max() < images[1].max() < images[2].max()


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: SpecularReflection(1.5), "clearcoat is 1.5"),
        (lambda: SpecularReflection(0.5, clearcoat_gloss=-1.0), "clearcoat_gloss is -1.0"),
        (lambda: SpecularReflection(0.5, ior=0.9), "ior is 0.9. Allowed: 1"),
        (lambda: SpecularReflection(0.5).on_organ(sphere(1)), "no appearance"),
        (lambda: Distortion(0.5), "strength is 0.5"),
        (
            lambda: Distortion(0.1).on(make_camera("equirectangular")),
            "equirectangular has no image",
        ),
        (lambda: DomeBubbles(-1), "count is -1"),
        (lambda: FieldOfView(0.0), "magnification is 0.0"),
        (lambda: Resolution(0.0), "scale is 0.0"),
        (lambda: Resolution(0.05).on(make_camera()), "Allowed: 8 or more per side"),
    ],
)
def test_what_cannot_be(make, match: str) -> None:
    with pytest.raises(InputError, match=match):
        make()
