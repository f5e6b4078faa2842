from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.programs import run_program
from tests.support.shapes import DIRECT, looking, make_camera, make_model, patterned, pinhole, tube
from vrcaps import _core
from vrcaps._core import testing
from vrcaps.camera.camera import Camera
from vrcaps.camera.derive import scaled_camera
from vrcaps.camera_pipeline.capsule_cameras import CapsuleCameras
from vrcaps.camera_pipeline.effect.base import CameraSetup, ImageEffect
from vrcaps.camera_pipeline.effect.exposure import (
    AdaptiveFrameRate,
    AutoExposure,
    MotionBlur,
    RollingShutter,
)
from vrcaps.camera_pipeline.effect.optics import DepthOfField
from vrcaps.camera_pipeline.effect.sensor import BayerFilter, SensorNoise
from vrcaps.camera_pipeline.effects import EFFECTS, SEVERITIES, Effects
from vrcaps.camera_pipeline.pipeline import CameraPipeline, PipelineState
from vrcaps.capsule.device_file import read_device
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import transform_from
from vrcaps.lumen.contents import Contents
from vrcaps.motion.motion import Step
from vrcaps.render.channels import Frame
from vrcaps.render.renderer import Renderer
from vrcaps.render.sampling import crop_margin
from vrcaps.world.model import State

IMAGE_EFFECTS = sorted(name for name in SEVERITIES if issubclass(EFFECTS[name], ImageEffect))
CAMERA = make_camera("equidistant", image_circle_px=38.0, exposure=4.0)
NOW = looking((0.002, 0.001, 0.05), (0.1, 0.05, 1.0))


@pytest.fixture(scope="module")
def renderer() -> Renderer:
    organ = tube(48, 80, folds=0.3, appearance=patterned(np.random.default_rng(3)))
    return Renderer(make_model(organ, CAMERA), DIRECT)


def moved(state: State, step: tuple[float, float, float]) -> State:
    return replace(state, T_world_capsule=state.T_world_capsule @ transform_from(np.eye(3), step))


def captured(
    renderer: Renderer,
    effects: Effects,
    step: Step,
    *,
    camera: Camera = CAMERA,
    seed: int = 1,
    fps: float = 4.0,
    exposure: float = 1.0,
) -> Frame:
    channels = ("rgb", "depth", "label")
    pipeline = CameraPipeline(renderer, camera, effects, fps=fps, seed=seed, channels=channels)
    pipeline.state = PipelineState(exposure)
    return pipeline.capture(step)


def image_motion(
    renderer: Renderer, step: Step, effects: Effects, camera: Camera = CAMERA
) -> np.ndarray | None:
    pipeline = CameraPipeline(renderer, camera, effects, fps=4.0)
    return pipeline.image_motion(pipeline.render(step))


def around(index: int = 3) -> Step:
    return Step(index, NOW, moved(NOW, (0, 0, -0.004)), moved(NOW, (0, 0, 0.004)))


def test_no_effect_leaves_the_image_as_it_is(renderer: Renderer) -> None:
    plain = renderer.render(NOW, CAMERA, channels=("rgb",)).rgb
    seen = captured(renderer, Effects(), around()).rgb
    assert np.abs(np.asarray(plain, int) - np.asarray(seen)).max() <= 1


@pytest.mark.parametrize("name", IMAGE_EFFECTS)
def test_each_stage_changes_color_alone_and_more_by_severity(renderer: Renderer, name: str) -> None:
    camera = scaled_camera(CAMERA, 3.0)
    plain = captured(renderer, Effects(), around(), camera=camera)
    lit = np.isfinite(np.asarray(plain.depth))
    differences = []
    for severity in (3, 4):
        effects = Effects(**{name: severity})
        frame = captured(renderer, effects, around(), camera=camera, exposure=1.4)
        assert np.array_equal(np.asarray(frame.depth), plain.depth, equal_nan=True)
        assert np.array_equal(np.asarray(frame.label), plain.label)
        change = np.asarray(frame.rgb, int) - np.asarray(plain.rgb, int)
        differences.append(np.abs(change)[lit].mean())
    assert differences[0] > 0.0
    assert differences[1] > (0.5 if name == "auto_exposure" else 1.1) * differences[0]


def test_frames_are_the_same_bytes_again_and_others_with_another_seed(renderer: Renderer) -> None:
    effects = Effects(**dict.fromkeys(SEVERITIES, 2), bayer_filter=BayerFilter("rggb"))
    one, again = (np.asarray(captured(renderer, effects, around()).rgb) for _ in range(2))
    assert np.array_equal(one, again)
    noisy = Effects(sensor_noise=2)
    first = np.asarray(captured(renderer, noisy, around()).rgb)
    assert not np.array_equal(first, captured(renderer, noisy, around(), seed=2).rgb)
    assert not np.array_equal(first, captured(renderer, noisy, around(4)).rgb)


def test_blur_is_the_flow_times_the_share_of_the_exposure(renderer: Renderer) -> None:
    """A long lens before a moving wall: the motion found is the flow at every fourth pixel, and a
    streak's length is |flow| · exposure time · frame rate."""
    step, effects = around(), Effects(motion_blur=MotionBlur(0.1))
    motion = image_motion(renderer, step, effects)
    frame = renderer.render(NOW, CAMERA, channels=("flow_forward",), state_next=step.next)
    assert np.isfinite(motion).mean() > 0.5
    error = np.abs(motion - np.asarray(frame.flow_forward)[2::4, 2::4])
    assert np.nanpercentile(error, 95) < 0.01
    assert np.nanmax(error) < 0.2  # at the very rim of the field
    last = image_motion(renderer, replace(step, next=None), effects)
    assert np.nanmedian(np.linalg.norm(last - motion, axis=-1)) < 1.0
    assert image_motion(renderer, Step(0, NOW), effects) is None


def test_bubbles_on_the_capsule_stay_where_they_are(renderer: Renderer) -> None:
    """The pipeline's motion is 0 where a bubble sits on the lens, and the wall's elsewhere."""
    camera = replace(CAMERA, position=(0.0, 0.0, 0.0056))
    organ = renderer.model.organ
    model = replace(
        make_model(organ, camera), contents=Effects(dome_bubbles=4).contents(Contents(seed=2))
    )
    motion = image_motion(Renderer(model, DIRECT), around(), Effects(motion_blur=2), camera)
    speed = np.linalg.norm(motion, axis=-1)
    front = (
        Renderer(model, DIRECT).render(NOW, camera, channels=("foreground_label",)).foreground_label
    )
    front = np.asarray(front)[2::4, 2::4]
    assert (front == 1).sum() > 5
    assert (speed[front == 1] == 0.0).all()
    assert np.nanmedian(speed[front == 0]) > 1.0


def test_a_bubble_is_out_of_focus_by_its_own_distance(renderer: Renderer) -> None:
    """With the wall's distance in focus alone, only where bubbles are does the image change."""
    camera = replace(CAMERA, position=(0.0, 0.0, 0.0056), exposure=1.0)
    camera = scaled_camera(camera, 3.0)
    model = replace(
        make_model(renderer.model.organ, camera),
        contents=Effects(dome_bubbles=4).contents(Contents(seed=2)),
    )
    through = Renderer(model, DIRECT)
    front = np.asarray(through.render(NOW, camera, channels=("foreground_label",)).foreground_label)
    near = [
        np.asarray(captured(through, effects, Step(0, NOW), camera=camera).rgb, float)
        for effects in (Effects(), Effects(depth_of_field=DepthOfField(0.0005, 0.025)))
    ]
    change = np.abs(near[1] - near[0]).mean(axis=-1)
    assert change[front == 1].mean() > 3.0 * change[front == 0].mean()


def test_shutter_is_open_no_longer_than_a_frame(renderer: Renderer) -> None:
    longest, longer = (
        np.asarray(captured(renderer, Effects(motion_blur=MotionBlur(t)), around()).rgb)
        for t in (0.25, 2.0)
    )
    assert np.array_equal(longest, longer)
    alone = captured(renderer, Effects(rolling_shutter=RollingShutter(0.1)), Step(0, NOW)).rgb
    assert np.array_equal(np.asarray(alone), captured(renderer, Effects(), Step(0, NOW)).rgb)


@pytest.mark.parametrize("side", [2, 3, 4])
def test_small_images_get_all_effects_or_one_clear_line(renderer: Renderer, side: int) -> None:
    camera, chain = make_camera(pinhole(side)), Effects().of_device(read_device("mirocam"))
    plain = CameraPipeline(renderer, camera, Effects(), fps=4.0).capture(Step(0, NOW))
    assert plain.rgb.shape == (side, side, 3)
    if side < 4:
        with pytest.raises(InputError, match=rf"is {side}\. Allowed: 4 or more with effects"):
            CameraPipeline(renderer, camera, chain, fps=4.0)
    else:
        frame = CameraPipeline(renderer, camera, chain, fps=4.0).capture(Step(0, NOW))
        assert frame.rgb.shape == (side, side, 3)


def test_meter_reads_the_mean_luminance(renderer: Renderer) -> None:
    camera = make_camera(pinhole(96), exposure=0.02)
    effects = Effects(auto_exposure=1, vignetting=2)
    pipeline = CameraPipeline(renderer, camera, effects, fps=4.0)
    frame = renderer.render(NOW, camera, channels=("radiance",))
    linear = np.asarray(frame.radiance, float) @ (0.2126, 0.7152, 0.0722) * 0.02 * 1.5
    linear *= SEVERITIES["vignetting"][2].params(CameraSetup(camera))
    metered = pipeline.meter(pipeline.render(Step(0, NOW)), 1.5)
    assert metered == pytest.approx(np.minimum(linear, 1.0).mean(), rel=0.05)


def test_gain_makes_noise_and_light_does_not(renderer: Renderer) -> None:
    """At the same brightness, what the LEDs give is less noisy than what gain makes of it."""
    noise = SensorNoise(2000.0, 0.0)
    spread = []
    for exposure, camera in ((1.9, CAMERA), (7.6, replace(CAMERA, exposure=1.0))):
        effects = Effects(auto_exposure=1, sensor_noise=noise)
        one, other = (
            np.asarray(
                captured(renderer, effects, Step(k, NOW), camera=camera, exposure=exposure).rgb,
                float,
            )
            for k in (0, 1)
        )
        spread.append((one - other).std())
    assert spread[1] > 1.3 * spread[0]


FOCAL = 40.0


def rays_to(x: np.ndarray, y: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Points at depth 1 that a pinhole sees at positions of an image [px]."""
    height, width = size
    return np.stack([(x - width / 2) / FOCAL, (y - height / 2) / FOCAL, np.ones_like(x)], -1)


READOUT = {"full_well": 900.0, "read_noise": 5.0, "white": 1023.0, "black": 64.0}


def setup(rng: np.random.Generator, height: int, width: int, bayer: object = None) -> dict:
    """Every stage, on an image whose corner is dark."""
    y, x = np.mgrid[:height, :width].astype(float)
    rays = rays_to(x, y, (height, width))
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    planes = rng.random((3, height, width), np.float32)
    lit = np.ones((height, width), bool)
    lit[:7, :9] = False
    sites = ((1 if bayer else 3) * height, width)
    pattern = [_core.standard_normal(sites, 3, k) * 0.01 + 1 - k for k in (0, 1)]
    stages = {
        "motion_blur": (0.3, 0.25),
        "rolling_shutter": 0.2,
        "depth_of_field": (0.03, 0.015),
        "smears": (0.5 + 0.5 * planes, 1.0 - 0.3 * planes[0], float(lit.sum())),
        "chromatic_aberration": ((0.5 * width, 0.5 * height), (1.01, 1.0, 0.99)),
        "vignetting": 1.0 - 0.5 * planes[1],
        "bloom": (0.1, 5.0),
        "sensor_noise": READOUT | {"pattern": pattern},
        "white_balance": ((1.0, 1.1, 0.9), (0.6, 1.0, 0.7)),
        "jpeg": (60, None),
    }
    if bayer:
        stages["bayer_filter"] = bayer
    return {
        "rays": _core.RayTable(rays.astype(np.float32)),
        "lit": lit,
        "cosine": np.full((height, width), 0.8, np.float32),
        "stages": stages,
    }


def frame_params(rng: np.random.Generator, height: int, width: int) -> dict:
    distance = rng.uniform(0.005, 0.08, (height, width)).astype(np.float32)
    front = (rng.random((height, width)) < 0.2).astype(np.uint8)
    y, x = np.mgrid[2:height:4, 2:width:4].astype(float)
    dx, dy = rng.normal(0, 6, (2, *x.shape))
    points = np.ascontiguousarray(rays_to(x + dx, y + dy, (height, width)), np.float32)
    pixels = rng.choice(height * width, 40, replace=False).astype(np.uint32)
    sources = rng.integers(0, height * width, (40, 3), dtype=np.uint32)
    return {
        "exposure": 1.3,
        "points": (points, np.eye(4), None),
        "is_backward": True,
        "stages": {
            "depth_of_field": (distance, front, 0.5 * distance),
            "droplets": (pixels, sources, rng.random((40, 3), np.float32) / 2),
            "auto_exposure": (1.2, 1.1),
        },
        "key": (9, 4),
    }


def light(rng: np.random.Generator, given: dict) -> np.ndarray:
    """Radiance where the image is lit."""
    return rng.random((3, *given["lit"].shape), np.float32) * given["lit"]


def framed(pipeline: _core.CameraPipeline, radiance: np.ndarray) -> np.ndarray:
    """The same with a margin in which anything may be."""
    planes = np.full(pipeline.planes_shape, np.nan, np.float32)
    crop_margin(planes, *radiance.shape[1:])[...] = radiance
    return planes


def one_by_one(radiance: np.ndarray, given: dict, frame: dict) -> np.ndarray:
    """The same stages, each called by itself."""
    stages, lit = given["stages"], given["lit"]
    image = np.ascontiguousarray(np.moveaxis(radiance, 0, -1))
    motion = -_core.flow_by_rays(given["rays"], frame["points"], 4)
    opened, pulse = stages["motion_blur"]
    shutter = (opened, stages["rolling_shutter"], pulse)
    planes = testing.motion_blur(image, lit, motion, shutter, frame["exposure"])
    wall, front, depth = frame["stages"]["depth_of_field"]
    distance = np.where(front == 1, depth / given["cosine"], wall)
    planes = testing.depth_of_field(planes, distance, *stages["depth_of_field"])
    planes = testing.dome(planes, stages["smears"], frame["stages"]["droplets"])
    planes = testing.chromatic_aberration(planes, *stages["chromatic_aberration"])
    planes = testing.bloom(testing.vignetting(planes, stages["vignetting"]), *stages["bloom"])
    bayer, (brightness, gain) = stages.get("bayer_filter"), frame["stages"]["auto_exposure"]
    gains, response = stages["white_balance"]
    readout = READOUT | {"light": brightness, "gain": gain, "response": response}
    pattern = stages["sensor_noise"]["pattern"]
    planes = testing.read_sensor(planes, pattern, readout, bayer, frame["key"])
    if bayer is not None:
        planes = testing.demosaic(planes, bayer)
    rgb = testing.develop(planes, gains, lit)
    quality, limit = stages["jpeg"]
    if limit is not None:
        quality = testing.jpeg_quality(rgb, quality, limit)
    return testing.jpeg(rgb, quality)


@pytest.mark.parametrize("bayer", [None, (0, 1, 1, 2)])
@pytest.mark.parametrize("max_bytes", [None, 2500])
def test_all_stages_at_once_are_all_stages_in_turn(bayer, max_bytes, rng) -> None:
    height, width = 61, 83
    given = setup(rng, height, width, bayer)
    given["stages"]["jpeg"] = (60, max_bytes)
    pipeline = _core.CameraPipeline(**given)
    for _ in range(2):  # the second time in memory of the first
        radiance, now = light(rng, given), frame_params(rng, height, width)
        seen = pipeline.apply(framed(pipeline, radiance), now)
        assert np.array_equal(seen, one_by_one(radiance, given, now))


def test_stages_that_are_off_leave_the_image_as_it_is(rng: np.random.Generator) -> None:
    given = setup(rng, 24, 28) | {"stages": {}}
    now = frame_params(rng, 24, 28) | {"points": None, "stages": {}}
    radiance, pipeline = light(rng, given), _core.CameraPipeline(**given)
    planes = radiance * np.float32(1.3)
    seen = pipeline.apply(framed(pipeline, radiance), now)
    assert np.array_equal(seen, testing.develop(planes, (1.0, 1.0, 1.0), given["lit"]))


def test_light_is_metered_on_few_lit_pixels(rng: np.random.Generator) -> None:
    given = setup(rng, 24, 28)
    radiance, pipeline = light(rng, given), _core.CameraPipeline(**given)
    factors = np.array([0.4, 1.6, 0.2])
    late = 0.2 * ((np.arange(24) + 0.5) / 24 - 0.5)
    lit = np.minimum(late + 0.15, 0.125) - np.maximum(late - 0.15, -0.125)
    luminance = (factors @ radiance.reshape(3, -1)).reshape(24, 28)
    luminance = luminance * given["stages"]["vignetting"]
    luminance = np.minimum(luminance * (lit / 0.25)[:, None], 1)
    thin = np.s_[4::8, 2::4]
    expected = luminance[thin][given["lit"][thin]].mean()
    metered = pipeline.meter(framed(pipeline, radiance), tuple(factors))
    assert metered == pytest.approx(expected, rel=1e-6)
    dark = _core.CameraPipeline(**given | {"lit": np.zeros((24, 28), bool)})
    assert dark.meter(framed(dark, radiance), tuple(factors)) == 0.0


@pytest.mark.parametrize(
    ("wrong", "match"),
    [
        ({"lit": np.ones((24, 27), bool)}, "of one size"),
        ({"cosine": np.ones((23, 28), np.float32)}, "of one size"),
        ({"vignetting": np.ones((28, 24), np.float32)}, "of one size"),
        ({"bayer_filter": (0, 1, 1, 2)}, "of one size"),
        ({"bayer_filter": (0, 1, 1, 3)}, "of one size"),
        ({"fog": 1.0}, "No stage fog"),
    ],
)
def test_stages_that_do_not_fit_each_other(wrong: dict, match: str, rng) -> None:
    given = setup(rng, 24, 28)
    for name, value in wrong.items():
        (given if name in given else given["stages"])[name] = value
    with pytest.raises(ValueError, match=match):
        _core.CameraPipeline(**given)


def test_frames_that_do_not_fit_the_stages(rng: np.random.Generator) -> None:
    pipeline, now = _core.CameraPipeline(**setup(rng, 24, 28)), frame_params(rng, 24, 28)
    image = framed(pipeline, np.ones((3, 24, 28), np.float32))
    distance = np.ones((24, 28), np.float32)
    small = (distance, np.ones((3, 3), np.uint8), distance)
    wrong = (
        (image[:, :20], now),
        (np.ones((3, 24, 28), np.float32), now),
        (image, now | {"stages": {}}),
        (image, now | {"stages": {"depth_of_field": small}}),
    )
    for radiance, frame in wrong:
        with pytest.raises(ValueError, match="of one size"):
            pipeline.apply(np.ascontiguousarray(radiance), frame)
    points = (np.ones((24, 28, 3), np.float32), np.eye(4), None)
    with pytest.raises(ValueError, match="must fit the camera"):
        pipeline.apply(image, now | {"points": points})
    with pytest.raises(ValueError, match="of one size"):
        pipeline.meter(image[:, :, :5].copy(), (1.0, 1.0, 1.0))


SCRIPT = """
import hashlib, numpy as np
from vrcaps import _core
from vrcaps._core import testing
rng = np.random.default_rng(0)
image = rng.random((61, 83, 3), np.float32)
lit = np.ones((61, 83), bool)
motion = rng.normal(0, 9, (16, 21, 2)).astype(np.float32)
distance = rng.uniform(0.005, 0.08, (61, 83)).astype(np.float32)
planes = testing.motion_blur(image, lit, motion, (0.3, 0.2, 0.4), 1.0)
planes = testing.depth_of_field(planes, distance, 0.03, 0.015)
planes = testing.chromatic_aberration(planes, (41.0, 30.0), (1.01, 1.0, 0.99))
planes = testing.bloom(testing.vignetting(planes, distance * 10), 0.1, 5.0)
readout = dict(full_well=900.0, read_noise=5.0, light=1.2, gain=1.0, white=1023.0,
               black=16.0, response=(0.6, 1.0, 0.7))
pattern = [_core.standard_normal((61, 83), 3, k) * 0.01 + 1 - k for k in (0, 1)]
raw = testing.read_sensor(planes, pattern, readout, (0, 1, 1, 2), (9, 4))
rgb = testing.develop(testing.demosaic(raw, (0, 1, 1, 2)), (1.0, 1.0, 1.1), lit)
rgb = testing.jpeg(rgb, testing.jpeg_quality(rgb, 90, 3000))
print(hashlib.sha256(rgb.tobytes()).hexdigest())
"""


def test_stages_are_the_same_bytes_on_any_number_of_threads() -> None:
    def digest(threads: str) -> str:
        run = run_program(SCRIPT, environment={"RAYON_NUM_THREADS": threads})
        assert run.returncode == 0, run.stderr
        return run.stdout

    assert Path(_core.__file__).exists()
    assert digest("1") == digest("3")


def blur(f, lit: tuple[int, ...], motion: tuple[int, ...]):
    return testing.motion_blur(f(4, 4, 3), f(*lit) > 0, f(*motion), (0.1, 0.1, 1.0), 1.0)


def flow(f, points: tuple[int, ...], front: tuple | None = None):
    return _core.flow_by_rays(_core.RayTable(f(4, 4, 3)), (f(*points), np.eye(4), front), 4)


@pytest.mark.parametrize(
    ("call", "match"),
    [
        (lambda f: blur(f, (4, 5), (1, 1, 2)), "fit"),
        (lambda f: blur(f, (4, 4), (1, 1, 3)), "Motion"),
        (lambda f: testing.depth_of_field(f(3, 4, 4), f(4, 5), 1.0, 1.0), "Distances"),
        (lambda f: testing.depth_of_field(f(2, 4, 4), f(4, 4), 1.0, 1.0), "Planes must"),
        (lambda f: testing.vignetting(f(3, 4, 4), f(4, 5)), "A map"),
        (lambda f: flow(f, (1, 1, 2)), "shape"),
        (lambda f: flow(f, (2, 2, 3)), "must fit the camera"),
        (
            lambda f: flow(
                f, (1, 1, 3), (f(4, 5).astype(np.uint8), f(4, 4), np.eye(4), (0.01, 0.005))
            ),
            "Foreground arrays",
        ),
        (lambda f: testing.develop(f(3, 4, 4), (1.0, 1.0, 1.0), f(4, 5) > 0), "mask of lit pixels"),
        (lambda f: testing.demosaic(f(1, 2, 4), (0, 1, 1, 2)), "3 by 3"),
        (lambda f: testing.demosaic(f(3, 4, 4), (0, 1, 1, 2)), "A mosaic must"),
        (lambda f: testing.jpeg(f(4, 4, 3).astype(np.uint8), 0), "from 1 to 100"),
        (lambda f: testing.jpeg(f(4, 4, 2).astype(np.uint8), 50), "image must be"),
    ],
)
def test_arrays_that_do_not_fit(call, match: str) -> None:
    with pytest.raises(ValueError, match=match):
        call(lambda *shape: np.zeros(shape, np.float32))


def test_patterns_that_do_not_fit() -> None:
    readout = READOUT | {"light": 1.0, "gain": 1.0, "response": (1.0, 1.0, 1.0)}
    planes, flat = np.ones((3, 4, 4), np.float32), np.ones((4, 4), np.float32)
    with pytest.raises(ValueError, match="one value per photosite"):
        testing.read_sensor(planes, (flat, flat), readout, None, (0, 0))
    with pytest.raises(ValueError, match="Colors of a mosaic"):
        testing.read_sensor(planes, (flat, flat), readout, (0, 1, 1, 3), (0, 0))


def test_exposure_is_a_state_that_can_be_kept_and_set(renderer: Renderer) -> None:
    """The same steps from the same state are the same bytes; metering once or twice is the same."""
    effects = Effects(auto_exposure=2, sensor_noise=2)

    def pipeline() -> CameraPipeline:
        made = CameraPipeline(renderer, CAMERA, effects, fps=4.0, seed=3)
        made.state = PipelineState(1.0)
        return made

    whole, again, steps = pipeline(), pipeline(), [around(k) for k in range(3)]
    frames = [whole.capture(step) for step in steps]
    again.expose(steps[0])
    assert again.expose(steps[0]).exposure == 1.0
    kept = again.state
    assert kept.exposure != 1.0
    later = pipeline()
    later.state = kept
    for frame, step in zip(frames[1:], steps[1:], strict=True):
        assert np.array_equal(np.asarray(later.capture(step).rgb), frame.rgb)


def test_frames_may_be_finished_later_on_other_threads(renderer: Renderer) -> None:
    """The same bytes as those of frames captured one by one."""
    effects = Effects(auto_exposure=2, motion_blur=2, sensor_noise=2, smears=2, jpeg=2)
    channels = ("rgb", "depth", "dome_label", "flow_forward")
    steps = [around(k) for k in range(3)]

    def pipeline() -> CameraPipeline:
        return CameraPipeline(renderer, CAMERA, effects, fps=4.0, seed=3, channels=channels)

    one_by_one, begun = pipeline(), pipeline()
    whole = [one_by_one.capture(step) for step in steps]
    finish = [begun.begin_capture(step) for step in steps]
    with ThreadPoolExecutor(3) as threads:
        later = list(threads.map(lambda function: function(), reversed(finish)))
    for frame, other in zip(whole, reversed(later), strict=True):
        for channel in channels:
            assert np.array_equal(getattr(frame, channel), getattr(other, channel), equal_nan=True)


def test_settled_exposure_depends_on_no_other_frame(renderer: Renderer) -> None:
    """Frames in any order are the same bytes, and each is metered at the target."""
    effects = Effects(auto_exposure=AutoExposure(0.0, target=0.2))
    pipeline = CameraPipeline(renderer, CAMERA, effects, fps=4.0)
    steps = [around(k) for k in range(3)]
    frames = [np.asarray(pipeline.capture(step).rgb) for step in steps]
    for step in steps:
        exposed = pipeline.expose(step)
        assert exposed.luminance == pytest.approx(0.2, rel=1e-3)
    alone = CameraPipeline(renderer, CAMERA, effects, fps=4.0)
    assert np.array_equal(np.asarray(alone.capture(steps[2]).rgb), frames[2])


def test_a_frame_without_neighbors_has_no_flow(renderer: Renderer) -> None:
    channels = ("rgb", "flow_forward", "flow_backward", "occlusion")
    for effects in (Effects(), Effects(jpeg=1)):
        pipeline = CameraPipeline(renderer, CAMERA, effects, fps=4.0, channels=channels)
        alone = pipeline.capture(Step(0, NOW))
        assert np.isnan(alone.flow_forward).all() and np.isnan(alone.flow_backward).all()
        assert np.asarray(alone.occlusion).all()
        assert np.isfinite(pipeline.capture(around()).flow_forward).any()


def test_cameras_of_a_capsule_go_on_from_their_state(renderer: Renderer) -> None:
    """Exposure and the last captured frame are a value; the recorder finds both in its table."""
    rate = AdaptiveFrameRate(1.0, 4.0, low_motion=0.0, high_motion=0.5)
    effects = Effects(auto_exposure=2, adaptive_frame_rate=rate)
    target = AutoExposure(1.0).target

    def cameras() -> CapsuleCameras:
        return CapsuleCameras(renderer, effects, fps=4.0)

    steps = [around(k) for k in range(4)]
    whole, later, resumed = cameras(), cameras(), cameras()
    readings = [whole.expose(step) for step in steps[:2]]
    assert readings[0]["captured"] == 1
    # The loop starts settled.
    assert readings[0]["eye_luminance"] == pytest.approx(target, rel=1e-3)
    later.state = whole.state
    captured = [k for k, row in enumerate(readings) if row["captured"]]
    resumed.resume(readings[-1], captured[-1])
    assert resumed.state == later.state == whole.state
    expected = [(whole.expose(step), whole.capture(step)["eye"].rgb) for step in steps[2:]]
    for again in (later, resumed):
        for step, (row, rgb) in zip(steps[2:], expected, strict=True):
            assert again.expose(step) == row
            assert np.array_equal(np.asarray(again.capture(step)["eye"].rgb), rgb)
