"""Drops and smears on the dome against the optics they are made of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.support.shapes import DIRECT, looking, make_camera, make_model, pinhole, sphere
from vrcaps._core import testing
from vrcaps.camera.derive import focal_length_px, scaled_camera
from vrcaps.camera_pipeline.effect.base import CameraSetup, Stage
from vrcaps.camera_pipeline.effect.dome import SUBSTANCES, Droplets, DropletsStage, DropMap, Smears
from vrcaps.camera_pipeline.effect.optics import DepthOfField
from vrcaps.camera_pipeline.effects import SEVERITIES, Effects
from vrcaps.camera_pipeline.pipeline import CameraPipeline
from vrcaps.capsule.device_file import read_device
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.units import DEG, MM
from vrcaps.motion.motion import Step
from vrcaps.render.channels import Frame
from vrcaps.render.renderer import Renderer

CAMERA = make_camera(pinhole(201, 1.2))
PIN = DepthOfField(1e-9, 0.05)
"""A pinhole: what lies on the dome is sharp."""


def ramps(size: int = 201) -> np.ndarray:
    """Planes whose values are the column and the row of each pixel."""
    row, column = np.mgrid[:size, :size].astype(np.float32)
    return np.stack([column, row, np.ones_like(row)])


def stage_of(effect: Droplets | Smears, *, seed: int = 0, lens: DepthOfField = PIN) -> Stage:
    return effect.stage(CameraSetup(CAMERA, seed=seed, effects=(lens,)))


def label_of(stage: Stage, time: float = 0.0) -> np.ndarray:
    label = np.zeros((CAMERA.height, CAMERA.width), np.uint8)
    stage.mark_dome(label, time)
    return label


def through(drops: DropMap, planes: np.ndarray) -> np.ndarray:
    return testing.dome(planes, None, (drops.pixels, drops.sources, drops.weights))


def one_drop(droplets: Droplets, *, lens: DepthOfField = PIN) -> DropletsStage:
    """A drop whole in the image: the first of a few seeds."""
    for seed in range(50):
        stage = stage_of(droplets, seed=seed, lens=lens)
        label = label_of(stage)
        edge = label[0].any() or label[-1].any() or label[:, 0].any() or label[:, -1].any()
        if label.any() and not edge:
            return stage
    raise AssertionError("no drop in the image")


def center_of(label: np.ndarray) -> np.ndarray:
    return np.argwhere(label == 1).mean(axis=0)[::-1]


def test_a_drop_is_a_thin_lens_near_its_axis() -> None:
    """Turned by r/f with the focal length f = R/(n − 1) of a plano-convex lens."""
    droplets = Droplets(1, contact_angle=40.0 * DEG)
    base = 0.8 * MM
    focal = base / np.sin(40.0 * DEG) / (droplets.ior - 1.0)
    offset = np.array([1e-4, 1e-3, 1e-2]) * base
    turn, share = droplets.refract(offset, np.full(3, base))
    np.testing.assert_allclose(turn, offset / focal, rtol=1e-4)
    normal = ((droplets.ior - 1.0) / (droplets.ior + 1.0)) ** 2
    np.testing.assert_allclose(share, 1.0 - normal, rtol=1e-4)


def test_the_rim_of_a_steep_drop_lets_nothing_out() -> None:
    """Totally reflected where sin α > 1/n."""
    droplets = Droplets(1, contact_angle=70.0 * DEG)
    critical = 1.0 / droplets.ior / np.sin(droplets.contact_angle)
    offset = critical + np.array([-1e-3, 1e-3, 0.1])
    _, share = droplets.refract(offset * MM, np.full(3, MM))
    assert share[0] > 0.2 and share[1] == pytest.approx(0.0, abs=1e-12) and share[2] < 1e-12


@pytest.mark.parametrize("contact", [20.0, 50.0])
def test_the_image_in_a_drop(contact: float) -> None:
    """Near its axis a drop magnifies by 1 − (D/f)(1 − D/s): steep ones turn the image over."""
    droplets = Droplets(1, radius=1.0 * MM, spread=0.0, contact_angle=contact * DEG)
    drop = one_drop(droplets)
    seen, label = through(drop.at_time(0.0), ramps()), label_of(drop)
    column, row = center_of(label)
    focal = droplets.radius / np.sin(droplets.contact_angle) / (droplets.ior - 1.0)
    distance, focus = droplets.distance, PIN.focus_distance
    expected = 1.0 - distance / focal * (1.0 - distance / focus)
    assert (expected < 0.0) == (contact > 30.0)
    half = round(0.15 * np.sqrt(np.count_nonzero(label) / np.pi))
    x, y = round(column), round(row)
    window = (slice(y - half, y + half + 1), slice(x - half, x + half + 1))
    steps = np.arange(-half, half + 1)
    share = seen[2][window].mean()
    across = np.polyfit(steps, (seen[0][window] / share).mean(axis=0), 1)[0]
    down = np.polyfit(steps, (seen[1][window] / share).mean(axis=1), 1)[0]
    tolerance = 0.06 + 0.03 * abs(expected)  # pixels are whole, the drop is a little off the axis
    assert abs(across - expected) < tolerance and abs(down - expected) < tolerance
    untouched = label == 0
    np.testing.assert_array_equal(seen[:, untouched], ramps()[:, untouched])


def test_size_and_blur_of_a_drop() -> None:
    """A disk of a/D seen by a pinhole; an aperture blurs its edge over A |1 − D/s| / D."""
    droplets = Droplets(1, radius=0.8 * MM, spread=0.0)
    sharp = label_of(one_drop(droplets)) == 1
    angle = droplets.radius / droplets.distance
    radius = focal_length_px(CAMERA.lens) * angle
    # A pinhole camera stretches what is off its axis.
    assert radius < np.sqrt(np.count_nonzero(sharp) / np.pi) < 1.35 * radius
    wide = DepthOfField(0.6 * MM, 0.02)
    drop = one_drop(droplets, lens=wide)
    coverage = drop.at_time(0.0).coverage
    partly = np.count_nonzero((coverage > 0.0) & (coverage < 1.0))
    whole = np.count_nonzero(coverage == 1.0)
    blur = 0.3 * MM * (1.0 - droplets.distance / 0.02) / droplets.distance
    # The outermost of the few rays through the pupil do not reach its rim on every side.
    low, high = (
        ((angle + b) ** 2 - (angle - b) ** 2) / (angle - b) ** 2 for b in (0.7 * blur, blur)
    )
    assert low < partly / whole < high
    assert len(coverage) == partly + whole


def test_drops_slide_and_come_in_again() -> None:
    droplets = Droplets(1, radius=0.6 * MM, spread=0.0, speed=0.1 * MM)
    drop = one_drop(droplets)
    before = center_of(label_of(drop, 0.0))
    seconds = 2.0
    after = center_of(label_of(drop, seconds))
    way = focal_length_px(CAMERA.lens) * droplets.speed * seconds / droplets.distance
    assert 0.9 * way - 1.0 < np.linalg.norm(after - before) < 1.5 * way + 1.0
    assert any(label_of(drop, t).any() for t in np.linspace(300.0, 400.0, 12))
    again = label_of(one_drop(droplets), seconds)
    np.testing.assert_array_equal(again, label_of(drop, seconds))


def test_a_smear_tints_and_veils(rng: np.random.Generator) -> None:
    """exp(−(a + s) t) of the pixel's light and exp(−a t)(1 − exp(−s t)) of the mean."""
    smears = Smears(0.05 * MM, substance="bile")
    stage = smears.stage(CameraSetup(CAMERA, seed=4))
    planes = rng.random((3, 201, 201), np.float32)
    seen = testing.dome(planes, stage.params)
    even = testing.dome(np.ones_like(planes), stage.params).astype(float)
    absorption, scattering = SUBSTANCES["bile"]
    thick = -np.log(even) / np.array(absorption)[:, None, None]
    np.testing.assert_allclose(thick[0], thick[2], atol=3e-9)
    assert thick.min() + 3e-9 >= 0.0 and thick.max() > 0.03 * MM
    clear = np.exp(-scattering * thick[2])
    mean = planes.astype(float).mean(axis=(1, 2))[:, None, None]
    expected = even * (clear * planes + (1.0 - clear) * mean)
    np.testing.assert_allclose(seen, expected, atol=2e-5)
    lost = 1.0 - even.mean(axis=0) * clear
    sure = np.abs(lost - 0.1) > 1e-4
    np.testing.assert_array_equal((label_of(stage) == 2)[sure], (lost > 0.1)[sure])


def test_a_smear_has_its_coverage(rng: np.random.Generator) -> None:
    smears = Smears(0.02 * MM, coverage=0.3)
    places = rng.uniform(-0.5, 0.5, (20_000, 2))  # a dome half a meter wide has many streaks
    shares = [np.mean(smears.relief(places, 0.0, rng) > 0.0) for _ in range(4)]
    assert np.mean(shares) == pytest.approx(0.3, abs=0.02)


def test_blur_takes_fine_streaks_away() -> None:
    smears = Smears(0.02 * MM, coverage=0.5, width=0.1 * MM)
    places = np.random.default_rng(1).uniform(-0.02, 0.02, (2000, 2))
    fine, coarse = (
        smears.relief(places, blur, np.random.default_rng(2)).max() for blur in (0.0, 0.5 * MM)
    )
    assert coarse < 0.3 * fine


def test_the_dome_agrees_with_its_twin(rng: np.random.Generator) -> None:
    planes = rng.random((3, 13, 21), np.float32)
    left, clear = rng.random((3, 13, 21), np.float32), rng.random((13, 21), np.float32)
    pixels = np.array([5, 70, 200], np.uint32)
    sources = rng.integers(0, 13 * 21, (3, 4), dtype=np.uint32)
    weights = rng.random((3, 4), np.float32)
    seen = testing.dome(planes, (left, clear, 273.0), (pixels, sources, weights))
    bent = planes.reshape(3, -1).astype(float)
    bent[:, pixels] = (planes.reshape(3, -1)[:, sources] * weights).sum(axis=-1)
    veil = planes.astype(float).mean(axis=(1, 2))[:, None, None]
    expected = left * (clear * bent.reshape(planes.shape) + (1.0 - clear) * veil)
    np.testing.assert_allclose(seen, expected, rtol=2e-6, atol=1e-6)
    np.testing.assert_array_equal(testing.dome(planes), planes)


def test_refuses_smears_and_drops_that_do_not_fit() -> None:
    planes, pixels = np.zeros((3, 4, 5), np.float32), np.array([30], np.uint32)
    with pytest.raises(ValueError, match="of the planes' shape"):
        testing.dome(planes, (planes, np.zeros((4, 4), np.float32), 20.0))
    with pytest.raises(ValueError, match="as many sources"):
        testing.dome(planes, None, (pixels, pixels[None], np.ones((1, 1), np.float32)))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["droplets", "smears"])
def test_severities_cover_more_and_more(name: str) -> None:
    camera = scaled_camera(read_device("mirocam").cameras[0], 0.4)
    coverage = []
    for effect in SEVERITIES[name][1:]:
        marked = []
        for seed in range(8):
            label = np.zeros((camera.height, camera.width), np.uint8)
            effect.stage(CameraSetup(camera, seed=seed)).mark_dome(label, 0.0)
            marked.append(np.mean(label > 0))
        coverage.append(np.mean(marked))
    assert (np.diff(coverage) > 0.0).all() and 0.0 < coverage[0] < 0.1 and 0.2 < coverage[-1] < 0.8


def test_what_the_pipeline_says_of_the_dome() -> None:
    """Color changes, geometry does not, and the label is there when it is asked for."""
    organ, camera = sphere(3), make_camera(pinhole(96, 1.2))
    renderer = Renderer(make_model(organ, camera), DIRECT)
    step = Step(0, looking((0.0, 0.0, 0.0)))
    asked = ("rgb", "depth", "label", "dome_label")

    def frame(effects: Effects, number: int = 0) -> Frame:
        pipeline = CameraPipeline(
            renderer, camera, effects, camera_index=number, fps=2.0, seed=11, channels=asked
        )
        return pipeline.capture(step)

    dirty_dome = Effects(droplets=4, smears=3)
    ideal, dull, dirty = frame(Effects()), frame(Effects(vignetting=1)), frame(dirty_dome)
    assert not ideal.dome_label.any() and not dull.dome_label.any()
    assert set(np.unique(dirty.dome_label)) == {0, 1, 2}
    assert (dirty.rgb != ideal.rgb).any()
    for name in ("depth", "label"):
        np.testing.assert_array_equal(getattr(dirty, name), getattr(ideal, name))
    assert (frame(dirty_dome, 1).dome_label != dirty.dome_label).any()


@pytest.mark.parametrize(
    ("figures", "message"),
    [
        ({"count": 0}, "count is 0"),
        ({"radius": 3.0 * MM}, "radius is 0.003"),
        ({"spread": 2.0}, "spread is 2"),
        ({"contact_angle": 1.6}, "contact_angle is 1.6"),
        ({"ior": 0.9}, "ior is 0.9"),
        ({"distance": 0.0, "radius": 0.0}, "Droplets' "),
        ({"distance": 2.0}, "distance is 2"),
        ({"speed": -1.0}, "speed is -1"),
    ],
)
def test_refuses_drops_that_cannot_be(figures: dict[str, float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        replace(Droplets(1), **figures)


@pytest.mark.parametrize(
    ("figures", "message"),
    [
        ({"thickness": 0.0}, "thickness is 0"),
        ({"coverage": 1.0}, "coverage is 1"),
        ({"width": 0.0}, "width is 0"),
        ({"aspect_ratio": 0.5}, "aspect_ratio is 0.5"),
        ({"distance": 0.0}, "distance is 0"),
    ],
)
def test_refuses_smears_that_cannot_be(figures: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        replace(Smears(1e-5), **figures)


def test_refuses_smears_of_no_known_substance() -> None:
    with pytest.raises(UnknownNameError, match=r"No substance named 'oil'\. Known: bile, blood"):
        Smears(1e-5, substance="oil")
