import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from shapes import looking, make_camera, make_model, patterned, pinhole, tube
from vrcaps import _core
from vrcaps.camera.camera import Camera
from vrcaps.camera_pipeline.camera_changes import scaled_camera
from vrcaps.camera_pipeline.effects import Effects
from vrcaps.camera_pipeline.optics import Defocus, MotionBlur, RollingShutter
from vrcaps.camera_pipeline.pipeline import CameraChain, Moment
from vrcaps.camera_pipeline.sensor import Noise
from vrcaps.camera_pipeline.severities import GRADES
from vrcaps.lumen.contents import Contents
from vrcaps.render.frame import Frame, inside
from vrcaps.render.renderer import Renderer
from vrcaps.transforms import transform_from
from vrcaps.world.model import State

IMAGE_STAGES = sorted(
    set(GRADES) - {"specular", "bubbles", "field_of_view", "distortion", "resolution"}
)
CAMERA = make_camera("equidistant", image_circle_px=38.0, exposure=4.0)
NOW = looking((0.002, 0.001, 0.05), (0.1, 0.05, 1.0))


@pytest.fixture(scope="module")
def renderer() -> Renderer:
    organ = tube(48, 80, folds=0.3, appearance=patterned(np.random.default_rng(3)))
    return Renderer(make_model(organ, CAMERA))


def moved(state: State, step: tuple[float, float, float]) -> State:
    return replace(state, T_world_capsule=state.T_world_capsule @ transform_from(np.eye(3), step))


def taken(
    renderer: Renderer,
    effects: Effects,
    moment: Moment,
    *,
    camera: Camera = CAMERA,
    seed: int = 1,
    fps: float = 4.0,
) -> Frame:
    chain = CameraChain(effects, camera, number=0, fps=fps, seed=seed)
    return chain.apply(chain.see(renderer, moment, ("rgb", "depth", "label")), renderer)


def moving(chain: CameraChain, renderer: Renderer, moment: Moment) -> np.ndarray | None:
    return chain.motion(chain.see(renderer, moment, ("rgb",)), renderer)


def around(index: int = 3) -> Moment:
    return Moment(
        index, NOW, state_next=moved(NOW, (0, 0, 0.004)), state_previous=moved(NOW, (0, 0, -0.004))
    )


def test_no_effect_leaves_the_image_as_it_is(renderer: Renderer) -> None:
    plain = renderer.render(NOW, CAMERA, channels=("rgb",)).rgb
    seen = taken(renderer, Effects(), around()).rgb
    assert np.abs(np.asarray(plain, int) - np.asarray(seen)).max() <= 1


@pytest.mark.parametrize("name", IMAGE_STAGES)
def test_each_stage_changes_colour_alone_and_more_by_grade(renderer: Renderer, name: str) -> None:
    camera = scaled_camera(CAMERA, 3.0)
    plain = taken(renderer, Effects(), around(), camera=camera)
    lit = np.isfinite(np.asarray(plain.depth))
    moment = replace(around(), exposure=1.4)
    differences = []
    for grade in (3, 4):
        frame = taken(renderer, Effects(**{name: grade}), moment, camera=camera)
        assert np.array_equal(np.asarray(frame.depth), plain.depth, equal_nan=True)
        assert np.array_equal(np.asarray(frame.label), plain.label)
        change = np.asarray(frame.rgb, int) - np.asarray(plain.rgb, int)
        differences.append(np.abs(change)[lit].mean())
    assert differences[0] > 0.0
    assert differences[1] > (0.5 if name == "exposure" else 1.1) * differences[0]


def test_frames_are_the_same_bytes_again_and_others_with_another_seed(renderer: Renderer) -> None:
    effects = Effects(**dict.fromkeys(GRADES, 2), mosaic="rggb")
    one, again = (np.asarray(taken(renderer, effects, around()).rgb) for _ in range(2))
    assert np.array_equal(one, again)
    noisy = Effects(noise=2)
    first = np.asarray(taken(renderer, noisy, around()).rgb)
    assert not np.array_equal(first, taken(renderer, noisy, around(), seed=2).rgb)
    assert not np.array_equal(first, taken(renderer, noisy, around(4)).rgb)


def test_blur_is_the_flow_times_the_share_of_the_exposure(renderer: Renderer) -> None:
    """A long lens before a moving wall: the chain's motion is the flow at every fourth pixel, and a
    streak's length is |flow| · exposure time · frame rate."""
    chain = CameraChain(Effects(motion_blur=MotionBlur(0.1)), CAMERA, number=0, fps=4.0, seed=0)
    moment = around()
    motion = moving(chain, renderer, moment)
    frame = renderer.render(NOW, CAMERA, channels=("flow_forward",), state_next=moment.state_next)
    assert np.isfinite(motion).mean() > 0.5
    error = np.abs(motion - np.asarray(frame.flow_forward)[2::4, 2::4])
    assert np.nanpercentile(error, 95) < 0.01
    assert np.nanmax(error) < 0.2  # at the very rim of the field
    once = replace(NOW, time=1.0)
    last = moving(chain, renderer, replace(moment, state=once, state_next=None))
    assert np.nanmedian(np.linalg.norm(last - motion, axis=-1)) < 1.0
    assert moving(chain, renderer, Moment(0, replace(NOW, time=2.0))) is None


def test_bubbles_on_the_capsule_stay_where_they_are(renderer: Renderer) -> None:
    """The chain's motion is 0 where a bubble sits on the lens, and the wall's elsewhere."""
    camera = replace(CAMERA, T_capsule_camera=transform_from(np.eye(3), (0.0, 0.0, 0.0056)))
    organ = renderer.model.organ
    model = replace(
        make_model(organ, camera), contents=Effects(bubbles=4).contents(Contents(seed=2))
    )
    chain = CameraChain(Effects(motion_blur=2), camera, number=0, fps=4.0, seed=0)
    moment = around()
    speed = np.linalg.norm(moving(chain, Renderer(model), moment), axis=-1)
    front = Renderer(model).render(NOW, camera, channels=("foreground_label",)).foreground_label
    front = np.asarray(front)[2::4, 2::4]
    assert (front == 1).sum() > 5
    assert (speed[front == 1] == 0.0).all()
    assert np.nanmedian(speed[front == 0]) > 1.0


def test_a_bubble_is_out_of_focus_by_its_own_distance(renderer: Renderer) -> None:
    """With the wall's distance in focus alone, only where bubbles are does the image change."""
    camera = replace(
        CAMERA, T_capsule_camera=transform_from(np.eye(3), (0.0, 0.0, 0.0056)), exposure=1.0
    )
    camera = scaled_camera(camera, 3.0)
    model = replace(
        make_model(renderer.model.organ, camera),
        contents=Effects(bubbles=4).contents(Contents(seed=2)),
    )
    through = Renderer(model)
    front = np.asarray(through.render(NOW, camera, channels=("foreground_label",)).foreground_label)
    near = [
        np.asarray(taken(through, effects, Moment(0, NOW), camera=camera).rgb, float)
        for effects in (Effects(), Effects(depth_of_field=Defocus(0.0005, 0.025)))
    ]
    change = np.abs(near[1] - near[0]).mean(axis=-1)
    assert change[front == 1].mean() > 3.0 * change[front == 0].mean()


def test_shutter_is_open_no_longer_than_a_frame(renderer: Renderer) -> None:
    longest, longer = (
        np.asarray(taken(renderer, Effects(motion_blur=MotionBlur(t)), around()).rgb)
        for t in (0.25, 2.0)
    )
    assert np.array_equal(longest, longer)
    alone = taken(renderer, Effects(rolling_shutter=RollingShutter(0.1)), Moment(0, NOW)).rgb
    assert np.array_equal(np.asarray(alone), taken(renderer, Effects(), Moment(0, NOW)).rgb)


def test_meter_reads_the_mean_luminance(renderer: Renderer) -> None:
    camera = make_camera(pinhole(96), exposure=0.02)
    chain = CameraChain(Effects(exposure=1, vignette=2), camera, number=0, fps=4.0, seed=0)
    frame = renderer.render(NOW, camera, channels=("radiance",))
    linear = np.asarray(frame.radiance, float) @ (0.2126, 0.7152, 0.0722) * 0.02 * 1.5
    linear *= GRADES["vignette"][2].profile(camera)
    moment = Moment(0, NOW, exposure=1.5)
    metered = chain.meter(chain.see(renderer, moment, ("rgb",)))
    assert metered == pytest.approx(np.minimum(linear, 1.0).mean(), rel=0.05)


def test_gain_makes_noise_and_light_does_not(renderer: Renderer) -> None:
    """At the same brightness, what the LEDs give is less noisy than what gain makes of it."""
    noise = Noise(2000.0, 0.0)
    spread = []
    for exposure, camera in ((1.9, CAMERA), (7.6, replace(CAMERA, exposure=1.0))):
        effects = Effects(exposure=1, noise=noise)
        one, other = (
            np.asarray(
                taken(renderer, effects, Moment(k, NOW, exposure=exposure), camera=camera).rgb,
                float,
            )
            for k in (0, 1)
        )
        spread.append((one - other).std())
    assert spread[1] > 1.3 * spread[0]


FOCAL = 40.0


def rays_to(x: np.ndarray, y: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Where places of an image [px] are seen by a pinhole, at depth 1."""
    height, width = size
    return np.stack([(x - width / 2) / FOCAL, (y - height / 2) / FOCAL, np.ones_like(x)], -1)


def fixed(rng: np.random.Generator, height: int, width: int) -> dict:
    """Every stage, on an image whose corner is dark."""
    y, x = np.mgrid[:height, :width].astype(float)
    rays = rays_to(x, y, (height, width))
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    planes = rng.random((3, height, width), np.float32)
    lit = np.ones((height, width), bool)
    lit[:7, :9] = False
    return {
        "rays": _core.RayTable(rays.astype(np.float32)),
        "lit": lit,
        "cosine": np.full((height, width), 0.8, np.float32),
        "shutter": (0.3, 0.2, 0.25),
        "defocus": (0.03, 0.015),
        "film": (0.5 + 0.5 * planes, 1.0 - 0.3 * planes[0], float(lit.sum())),
        "scales": ((0.5 * width, 0.5 * height), (1.01, 1.0, 0.99)),
        "shade": 1.0 - 0.5 * planes[1],
        "bloom": (0.1, 5.0),
        "pattern": [
            _core.standard_normal((3 * height, width), 3, k) * 0.01 + 1 - k for k in (0, 1)
        ],
        "mosaic": None,
        "jpeg": (60, None),
    }


def shot(rng: np.random.Generator, height: int, width: int) -> dict:
    distance = rng.uniform(0.005, 0.08, (height, width)).astype(np.float32)
    front = (rng.random((height, width)) < 0.2).astype(np.uint8)
    y, x = np.mgrid[2:height:4, 2:width:4].astype(float)
    dx, dy = rng.normal(0, 6, (2, *x.shape))
    points = np.ascontiguousarray(rays_to(x + dx, y + dy, (height, width)), np.float32)
    pixels = rng.choice(height * width, 40, replace=False).astype(np.uint32)
    return {
        "factor": 1.3,
        "points": (points, np.eye(4), None),
        "is_backward": True,
        "distance": (distance, front, 0.5 * distance),
        "drops": (
            pixels,
            rng.integers(0, height * width, (40, 3), dtype=np.uint32),
            rng.random((40, 3), np.float32) / 2,
        ),
        "readout": Noise(900.0, 5.0).readout(1.1, (0.6, 1.0, 0.7), 1.2),
        "gains": (1.0, 1.1, 0.9),
        "key": (9, 4),
    }


def light(rng: np.random.Generator, given: dict) -> np.ndarray:
    """Radiance where the image is lit."""
    return rng.random((3, *given["lit"].shape), np.float32) * given["lit"]


def framed(stages: _core.CameraStages, radiance: np.ndarray) -> np.ndarray:
    """The same with a margin in which anything may be."""
    planes = np.full(stages.room, np.nan, np.float32)
    inside(planes, *radiance.shape[1:])[...] = radiance
    return planes


def one_by_one(radiance: np.ndarray, given: dict, shot: dict) -> np.ndarray:
    """The same stages, each called by itself."""
    image = np.ascontiguousarray(np.moveaxis(radiance, 0, -1))
    motion = -_core.flow_by_rays(given["rays"], shot["points"], 4)
    planes = _core.blur_motion(image, given["lit"], motion, given["shutter"], shot["factor"])
    wall, front, depth = shot["distance"]
    distance = np.where(front == 1, depth / given["cosine"], wall)
    planes = _core.defocus(planes, distance, *given["defocus"])
    planes = _core.through_dome(planes, given["film"], shot["drops"])
    planes = _core.scale_planes(planes, *given["scales"])
    planes = _core.bloom(_core.shade_planes(planes, given["shade"]), *given["bloom"])
    mosaic = given["mosaic"]
    planes = _core.read_sensor(planes, given["pattern"], shot["readout"], mosaic, shot["key"])
    if mosaic is not None:
        planes = _core.demosaic(planes, mosaic)
    rgb = _core.develop(planes, shot["gains"], given["lit"])
    quality, most = given["jpeg"]
    return _core.jpeg(rgb, quality if most is None else _core.jpeg_quality(rgb, quality, most))


@pytest.mark.parametrize("mosaic", [None, (0, 1, 1, 2)])
@pytest.mark.parametrize("most_bytes", [None, 2500])
def test_all_stages_at_once_are_all_stages_in_turn(mosaic, most_bytes, rng) -> None:
    height, width = 61, 83
    given = fixed(rng, height, width) | {"mosaic": mosaic, "jpeg": (60, most_bytes)}
    if mosaic is not None:
        given["pattern"] = [array[:height] for array in given["pattern"]]
    stages = _core.CameraStages(given)
    for _ in range(2):  # the second time in memory of the first
        radiance, now = light(rng, given), shot(rng, height, width)
        seen = stages.apply(framed(stages, radiance), now)
        assert np.array_equal(seen, one_by_one(radiance, given, now))


def test_stages_that_are_off_leave_the_image_as_it_is(rng: np.random.Generator) -> None:
    off = dict.fromkeys(
        ("shutter", "defocus", "film", "scales", "shade", "bloom", "mosaic", "jpeg")
    )
    given = fixed(rng, 24, 28) | off
    now = shot(rng, 24, 28) | dict.fromkeys(("points", "distance", "drops", "readout"))
    radiance, stages = light(rng, given), _core.CameraStages(given)
    planes = radiance * np.float32(1.3)
    seen = stages.apply(framed(stages, radiance), now)
    assert np.array_equal(seen, _core.develop(planes, now["gains"], given["lit"]))


def test_light_is_metered_on_few_lit_pixels(rng: np.random.Generator) -> None:
    given = fixed(rng, 24, 28)
    radiance, stages = light(rng, given), _core.CameraStages(given)
    factors = np.array([0.4, 1.6, 0.2])
    late = 0.2 * ((np.arange(24) + 0.5) / 24 - 0.5)
    lit = np.minimum(late + 0.15, 0.125) - np.maximum(late - 0.15, -0.125)
    luminance = (factors @ radiance.reshape(3, -1)).reshape(24, 28) * given["shade"]
    luminance = np.minimum(luminance * (lit / 0.25)[:, None], 1)
    thin = np.s_[4::8, 2::4]
    expected = luminance[thin][given["lit"][thin]].mean()
    metered = stages.meter(framed(stages, radiance), tuple(factors))
    assert metered == pytest.approx(expected, rel=1e-6)
    dark = _core.CameraStages(given | {"lit": np.zeros((24, 28), bool)})
    assert dark.meter(framed(dark, radiance), tuple(factors)) == 0.0


@pytest.mark.parametrize(
    "wrong",
    [
        {"lit": np.ones((24, 27), bool)},
        {"cosine": np.ones((23, 28), np.float32)},
        {"shade": np.ones((28, 24), np.float32)},
        {"mosaic": (0, 1, 1, 2)},
        {"mosaic": (0, 1, 1, 3), "pattern": [np.ones((24, 28), np.float32)] * 2},
    ],
)
def test_stages_that_do_not_fit_each_other(wrong: dict, rng: np.random.Generator) -> None:
    with pytest.raises(ValueError, match="of one size"):
        _core.CameraStages(fixed(rng, 24, 28) | wrong)


def test_frames_that_do_not_fit_the_stages(rng: np.random.Generator) -> None:
    stages, now = _core.CameraStages(fixed(rng, 24, 28)), shot(rng, 24, 28)
    image = framed(stages, np.ones((3, 24, 28), np.float32))
    distance = np.ones((24, 28), np.float32)
    wrong = (
        (image[:, :20], now),
        (np.ones((3, 24, 28), np.float32), now),
        (image, now | {"distance": None}),
        (image, now | {"distance": (distance, np.ones((3, 3), np.uint8), distance)}),
    )
    for radiance, frame in wrong:
        with pytest.raises(ValueError, match="of one size"):
            stages.apply(np.ascontiguousarray(radiance), frame)
    points = (np.ones((24, 28, 3), np.float32), np.eye(4), None)
    with pytest.raises(ValueError, match="must fit the camera"):
        stages.apply(image, now | {"points": points})
    with pytest.raises(ValueError, match="of one size"):
        stages.meter(image[:, :, :5].copy(), (1.0, 1.0, 1.0))


SCRIPT = """
import hashlib, numpy as np
from vrcaps import _core
rng = np.random.default_rng(0)
image = rng.random((61, 83, 3), np.float32)
lit = np.ones((61, 83), bool)
motion = rng.normal(0, 9, (16, 21, 2)).astype(np.float32)
distance = rng.uniform(0.005, 0.08, (61, 83)).astype(np.float32)
planes = _core.blur_motion(image, lit, motion, (0.3, 0.2, 0.4), 1.0)
planes = _core.defocus(planes, distance, 0.03, 0.015)
planes = _core.scale_planes(planes, (41.0, 30.0), (1.01, 1.0, 0.99))
planes = _core.bloom(_core.shade_planes(planes, distance * 10), 0.1, 5.0)
readout = dict(full_well=900.0, read_noise=5.0, light=1.2, gain=1.0, white=1023.0,
               black=16.0, response=(0.6, 1.0, 0.7))
pattern = [_core.standard_normal((61, 83), 3, k) * 0.01 + 1 - k for k in (0, 1)]
raw = _core.read_sensor(planes, pattern, readout, (0, 1, 1, 2), (9, 4))
rgb = _core.develop(_core.demosaic(raw, (0, 1, 1, 2)), (1.0, 1.0, 1.1), lit)
rgb = _core.jpeg(rgb, _core.jpeg_quality(rgb, 90, 3000))
print(hashlib.sha256(rgb.tobytes()).hexdigest())
"""


def test_stages_are_the_same_bytes_on_any_number_of_threads() -> None:
    def digest(threads: str) -> str:
        environment = os.environ | {"RAYON_NUM_THREADS": threads}
        run = subprocess.run(
            [sys.executable, "-c", SCRIPT], env=environment, capture_output=True, check=True
        )
        return run.stdout.decode()

    assert Path(_core.__file__).exists()
    assert digest("1") == digest("2") == digest("5")


def blur(f, lit: tuple[int, ...], motion: tuple[int, ...]):
    return _core.blur_motion(f(4, 4, 3), f(*lit) > 0, f(*motion), (0.1, 0.1, 1.0), 1.0)


def flow(f, points: tuple[int, ...], front: tuple | None = None):
    return _core.flow_by_rays(_core.RayTable(f(4, 4, 3)), (f(*points), np.eye(4), front), 4)


@pytest.mark.parametrize(
    ("call", "match"),
    [
        (lambda f: blur(f, (4, 5), (1, 1, 2)), "fit"),
        (lambda f: blur(f, (4, 4), (1, 1, 3)), "Motion"),
        (lambda f: _core.defocus(f(3, 4, 4), f(4, 5), 1.0, 1.0), "Distances"),
        (lambda f: _core.defocus(f(2, 4, 4), f(4, 4), 1.0, 1.0), "Planes must"),
        (lambda f: _core.shade_planes(f(3, 4, 4), f(4, 5)), "A map"),
        (lambda f: flow(f, (1, 1, 2)), "shape"),
        (lambda f: flow(f, (2, 2, 3)), "must fit the camera"),
        (
            lambda f: flow(
                f, (1, 1, 3), (f(4, 5).astype(np.uint8), f(4, 4), np.eye(4), (0.01, 0.005))
            ),
            "What is in front",
        ),
        (lambda f: _core.develop(f(3, 4, 4), (1.0, 1.0, 1.0), f(4, 5) > 0), "What is lit"),
        (lambda f: _core.demosaic(f(1, 2, 4), (0, 1, 1, 2)), "3 by 3"),
        (lambda f: _core.demosaic(f(3, 4, 4), (0, 1, 1, 2)), "A mosaic must"),
        (lambda f: _core.jpeg(f(4, 4, 3).astype(np.uint8), 0), "from 1 to 100"),
        (lambda f: _core.jpeg(f(4, 4, 2).astype(np.uint8), 50), "image must be"),
    ],
)
def test_arrays_that_do_not_fit(call, match: str) -> None:
    with pytest.raises(ValueError, match=match):
        call(lambda *shape: np.zeros(shape, np.float32))


def test_patterns_that_do_not_fit() -> None:
    readout, flat = Noise(100.0, 1.0).readout(1.0, (1.0, 1.0, 1.0)), np.ones((4, 4), np.float32)
    planes = np.ones((3, 4, 4), np.float32)
    with pytest.raises(ValueError, match="one number a site"):
        _core.read_sensor(planes, (flat, flat), readout, None, (0, 0))
    with pytest.raises(ValueError, match="Colours of a mosaic"):
        _core.read_sensor(planes, (flat, flat), readout, (0, 1, 1, 3), (0, 0))
