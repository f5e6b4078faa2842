"""Imaging modes: LEDs of any spectrum, and narrow bands."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.support.shapes import looking, make_camera, make_model, sphere
from vrcaps.camera.camera import Led
from vrcaps.core.color import LUMINANCE, log_linear_from_srgb, srgb_from_log_linear
from vrcaps.core.errors import InputError
from vrcaps.lumen.contents import Liquid
from vrcaps.mucosa.mucosa import ABSORPTION, MUCOSAE
from vrcaps.organ.surface import Appearance
from vrcaps.render.imaging import (
    PHOSPHOR,
    blood_density,
    led_light,
    narrow_band,
    unmix_chromophores,
)
from vrcaps.render.renderer import Renderer
from vrcaps.render.scattering import diffuse_reflectance, fresnel, internal_reflectance
from vrcaps.render.settings import RenderSettings

NM = np.arange(380.0, 701.0, 4.0)


def spectrum(*lines: tuple[float, float, float]) -> tuple[tuple[float, float], ...]:
    """LEDs as Gaussians of a middle, a full width at half and a power."""
    power = sum(p * np.exp(-4.0 * np.log(2.0) * ((NM - m) / w) ** 2) for m, w, p in lines)
    return tuple(zip(NM.tolist(), np.asarray(power).tolist(), strict=True))


def mucosa(base: float, blood: float, bile: float) -> np.ndarray:
    """Linear color of a tissue of known densities."""
    return np.exp(-base - np.array([blood, bile]) @ ABSORPTION)


VIOLET = spectrum((415.0, 20.0, 3.0), (545.0, 60.0, 1.0), (640.0, 60.0, 1.0))


def test_the_usual_leds_change_nothing(rng):
    """Their colors are those given, whatever holds them."""
    light, colors = led_light(PHOSPHOR), rng.uniform(0.01, 1.0, (200, 3))
    np.testing.assert_allclose(light.reflectance(colors), colors, rtol=1e-6)
    np.testing.assert_allclose(light.bands_nm, (610.0, 545.0, 465.0))
    liquid = Liquid(absorption=(3.0, 40.0, 200.0))
    np.testing.assert_allclose(light.liquid(liquid).absorption, liquid.absorption, rtol=1e-9)


def test_power_does_not_matter_but_its_spectrum_does():
    """The camera is balanced to white: twice the power is the same picture, gray stays gray."""
    twice = tuple((nm, 2.0 * power) for nm, power in VIOLET)
    color = mucosa(0.3, 0.9, 0.3)
    np.testing.assert_allclose(
        led_light(VIOLET).reflectance(color), led_light(twice).reflectance(color), rtol=1e-12
    )
    np.testing.assert_allclose(led_light(VIOLET).reflectance(np.full(3, 0.4)), 0.4, rtol=1e-6)


def test_two_lines_against_diffusion_by_hand():
    """LEDs of three sharp lines: blue has what diffusion says at its own wavelength.

    Compared are two such LEDs, so that the usual LEDs drop out. Of blue 2 % is the line of green.
    """
    epsilon = {440: 102580.0, 460: 44480.0}  # S. Prahl's table
    scattering = {nm: nm**-0.845 for nm in epsilon}
    blue = {
        nm: led_light(spectrum((nm, 1.0, 1.0), (572.0, 1.0, 1.0), (640.0, 1.0, 1.0)))
        for nm in epsilon
    }
    color = mucosa(0.2, 0.7, 0.0)
    found = {nm: -np.log(light.reflectance(color)[2]) for nm, light in blue.items()}
    internal = internal_reflectance(1.4)

    def density(absorption: float) -> float:
        return float(-np.log(diffuse_reflectance(np.array(absorption), internal=internal)))

    # Blood's absorption from its density of 0.7 in green, by bisection.
    low, high = 0.0, 10.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if density(middle) < 0.7 else (low, middle)
    green = 34.5e3 * 544.0**0.845  # mean extinction over scattering in green, to 2 %
    wanted = {nm: density(low * epsilon[nm] / scattering[nm] / green) for nm in epsilon}
    assert found[440] - found[460] == pytest.approx(wanted[440] - wanted[460], rel=0.04)


def test_violet_light_shows_vessels():
    """At 415 nm hemoglobin absorbs most, so blood in blue is darker; red hardly changes."""
    pale, vessel = mucosa(0.3, 0.6, 0.2), mucosa(0.3, 1.2, 0.2)
    light = led_light(VIOLET)
    usual, violet = vessel / pale, light.reflectance(vessel) / light.reflectance(pale)
    assert violet[2] < 0.85 * usual[2]
    assert violet[0] == pytest.approx(usual[0], rel=0.1)


def test_bile_shows_where_leds_shine_at_its_band():
    """Bilirubin absorbs most about 450 nm, hardly beyond 500 nm."""
    stained = mucosa(0.3, 0.0, 0.6)
    at_band, beyond = (
        led_light(spectrum((nm, 10.0, 1.0), (550.0, 60.0, 1.0), (640.0, 60.0, 1.0)))
        for nm in (452.0, 496.0)
    )
    assert at_band.reflectance(stained)[2] < 0.75 * beyond.reflectance(stained)[2]


def test_nothing_reflects_more_than_all(rng):
    colors = np.vstack([rng.uniform(0.01, 1.0, (500, 3)), np.zeros((1, 3)), np.ones((1, 3))])
    seen = led_light(VIOLET).reflectance(colors)
    assert np.isfinite(seen).all() and (seen > 0.0).all() and (seen <= 1.0).all()


def test_liquid_absorbs_what_it_holds():
    """Blood in a liquid absorbs more of violet light, as many times as hemoglobin does."""
    blood = tuple((20.0 * ABSORPTION[0]).tolist())
    violet = led_light(VIOLET).liquid(Liquid(absorption=blood)).absorption
    assert violet[2] > 3.0 * blood[2]
    assert min(violet) >= 0.0


def test_a_capsules_own_leds_light_the_image():
    """An even wall's image is that of its color under the device's LEDs."""
    albedo = np.rint(255.0 * np.array([0.75, 0.5, 0.42])).astype(np.uint8)
    look = Appearance(np.tile(albedo, (4, 4, 1)), np.full((4, 4), 255, np.uint8), np.zeros((4, 4)))
    organ = replace(sphere(3), appearance=replace(look, clearcoat=0.0))
    camera = make_camera(leds=(Led((0.0, 0.0, 0.0)),))
    model = make_model(organ, camera)
    own = replace(model, device=replace(model.device, led_spectrum=VIOLET))
    usual, violet = (
        Renderer(m, RenderSettings(light="direct")).render(
            looking((0.0, 0.0, 0.0)), camera, channels=("radiance", "albedo")
        )
        for m in (model, own)
    )
    wanted = led_light(VIOLET).reflectance(usual.albedo.astype(float))
    np.testing.assert_allclose(violet.albedo, wanted, rtol=0.03)
    assert violet.radiance[..., 2].mean() < 0.9 * usual.radiance[..., 2].mean()


def test_leds_without_a_color():
    with pytest.raises(InputError, match=r"camera's red 0\.0% of the light"):
        led_light(spectrum((450.0, 20.0, 1.0), (530.0, 30.0, 1.0)))


def test_reflectance_against_random_walks(rng):
    """Diffusion beside a Monte-Carlo walk in a half-space of index 1.4, isotropic scattering."""
    for absorption in (0.02, 0.1):
        walked = _walk(absorption, 20_000, rng)
        found = diffuse_reflectance(np.array(absorption), internal=internal_reflectance(1.4))
        assert found == pytest.approx(walked, rel=0.12)


def _walk(absorption: float, photons: int, rng: np.random.Generator) -> float:
    """Share of light entering head-on that leaves again; lengths in scattering lengths."""
    albedo = 1.0 / (1.0 + absorption)
    depth, cosine = np.zeros(photons), np.ones(photons)
    weight, back = np.ones(photons), 0.0
    for _ in range(3000):
        depth = depth + cosine * rng.exponential(1.0 / (1.0 + absorption), len(depth))
        out = depth < 0.0
        mirrored = rng.random(len(depth)) < fresnel(np.abs(cosine), 1.0 / 1.4)
        back += weight[out & ~mirrored].sum()
        depth = np.where(out, -depth, depth)
        keep = ~(out & ~mirrored)
        depth, weight = depth[keep], weight[keep] * albedo
        if len(depth) == 0 or weight.max() < 1e-4:
            break
        cosine = rng.uniform(-1.0, 1.0, len(depth))
    return back / photons


def test_a_color_is_taken_apart(rng):
    """Known base, blood and bile give what their absorption at both bands says."""
    for base, blood, bile in rng.uniform([0.1, 0.0, 0.0], [0.6, 2.5, 0.8], (20, 3)):
        green, violet, blue = narrow_band().reflectance(mucosa(base, blood, bile))
        for value, band, stain in ((green, 540, 0.08), (violet, 415, 0.88)):
            dense = blood_density(np.array(blood), band)
            assert value == pytest.approx(np.exp(-base - dense - stain * bile), rel=5e-3)
        assert blue == violet


def test_a_color_that_is_no_tissue_stays_a_reflectance(rng):
    """Gray, green and blue hold no blood; nothing reflects more than its red does."""
    colors = rng.uniform(0.01, 1.0, (500, 3))
    seen = narrow_band().reflectance(colors)
    assert np.isfinite(seen).all() and (seen > 0.0).all()
    assert (seen <= colors[:, :1] * (1.0 + 1e-9)).all()
    np.testing.assert_allclose(narrow_band().reflectance(np.full(3, 0.4)), 0.4)


def test_vessels_stand_out():
    """A vessel's contrast at 415 nm is 1.7 times that in white light or more."""
    around, vessel = mucosa(0.4, 0.8, 0.2), mucosa(0.4, 1.3, 0.2)
    white = np.log(around / vessel)
    narrow = np.log(narrow_band().reflectance(around) / narrow_band().reflectance(vessel))
    assert narrow[0] > white[1] > white[0]
    assert narrow[1] > 1.7 * white[1]


def test_pale_mucosa_is_neutral_and_plain_mucosa_as_bright_as_in_white_light():
    light, plain = narrow_band(), np.array(MUCOSAE["colon"].base_color)
    pale = mucosa(0.0, 0.5 * unmix_chromophores(np.log(plain))[1], 0.0)
    color = light.reflectance(pale) * light.led_gains
    np.testing.assert_allclose(color, color[0], rtol=3e-3)
    seen = light.reflectance(plain) * light.led_gains
    assert seen @ LUMINANCE == pytest.approx(plain @ LUMINANCE, rel=1e-6)


def test_textures_are_worked_on_in_pieces(rng):
    """Textures of any number of rows come out as their texels do one by one."""
    rows = rng.integers(0, 256, (300, 5, 3), np.uint8)
    look = Appearance(rows, np.zeros((300, 5), np.uint8), np.zeros((300, 5)))
    seen = narrow_band().appearance(look).albedo
    np.testing.assert_array_equal(
        seen, srgb_from_log_linear(narrow_band().color(log_linear_from_srgb(rows)))
    )


def test_a_wall_looks_like_its_color_by_the_light_of_the_bands():
    """An even wall, dull and dry: its image is that of white light times reflectance and gain."""
    albedo = np.rint(255.0 * np.array([0.75, 0.5, 0.42])).astype(np.uint8)
    look = Appearance(np.tile(albedo, (4, 4, 1)), np.full((4, 4), 255, np.uint8), np.zeros((4, 4)))
    organ = replace(sphere(3), appearance=replace(look, clearcoat=0.0))
    camera = make_camera(leds=(Led((0.0, 0.0, 0.0)),))
    model, channels = make_model(organ, camera), ("radiance", "albedo")
    white, narrow = (
        Renderer(model, RenderSettings(light="direct", imaging=imaging)).render(
            looking((0.0, 0.0, 0.0)), camera, channels=channels
        )
        for imaging in ("white-light", "narrow-band")
    )
    np.testing.assert_allclose(
        narrow.albedo, narrow_band().reflectance(white.albedo.astype(float)), rtol=0.03
    )
    np.testing.assert_allclose(narrow.radiance[..., 1], narrow.radiance[..., 2], rtol=5e-3)


def test_liquid_of_bile_and_blood():
    """Absorption at the bands is that of what the liquid holds."""
    blood, bile = 20.0, 150.0
    given = 5.0 + np.array([blood, bile]) @ ABSORPTION
    liquid = narrow_band().liquid(Liquid(absorption=tuple(given)))
    expected = 5.0 + blood * 394.0 / 34.7 + 0.88 * bile
    assert liquid.absorption[1] == liquid.absorption[2] == pytest.approx(expected)
    assert liquid.absorption[0] == pytest.approx(5.0 + blood * 46.5 / 34.7 + 0.08 * bile)
