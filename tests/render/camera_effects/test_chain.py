import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from shapes import looking, make_camera, make_model, patterned, pinhole, tube

from vrcaps import _core
from vrcaps.capsule.device import Camera
from vrcaps.render.camera_effects.chain import CameraChain, Moment
from vrcaps.render.camera_effects.effects import Effects
from vrcaps.render.camera_effects.grades import GRADES
from vrcaps.render.camera_effects.optics import Defocus, MotionBlur, RollingShutter
from vrcaps.render.camera_effects.scene import scaled_camera
from vrcaps.render.camera_effects.sensor import Noise
from vrcaps.render.frame import Frame
from vrcaps.render.renderer import Renderer
from vrcaps.tissue.contents.contents import Contents
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
    return chain.apply(chain.see(renderer, moment, ("rgb", "depth", "label")), renderer, moment)


def moving(chain: CameraChain, renderer: Renderer, moment: Moment) -> np.ndarray | None:
    return chain.motion(chain.see(renderer, moment, ("rgb",)), renderer, moment)


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
    front = Renderer(model).render(NOW, camera, channels=("front_label",)).front_label
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
    front = np.asarray(through.render(NOW, camera, channels=("front_label",)).front_label)
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
    metered = chain.meter(chain.see(renderer, moment, ("rgb",)), moment)
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


SCRIPT = """
import hashlib, numpy as np
from vrcaps import _core
rng = np.random.default_rng(0)
image = rng.random((61, 83, 3), np.float32)
lit = np.ones((61, 83), bool)
motion = rng.normal(0, 9, (16, 21, 2)).astype(np.float32)
distance = rng.uniform(0.005, 0.08, (61, 83)).astype(np.float32)
planes = _core.blur_motion(image, lit, (motion, 4), (0.3, 0.2, 0.4), 1.0)
planes = _core.defocus(planes, distance, 0.03, 0.015)
planes = _core.scale_planes(planes, (41.0, 30.0), (1.01, 1.0, 0.99))
planes = _core.bloom(_core.shade_planes(planes, distance * 10), 0.1, 5.0)
readout = dict(full_well=900.0, read_noise=5.0, light=1.2, gain=1.0, white=1023.0,
               black=16.0, response=(0.6, 1.0, 0.7))
pattern = [_core.normals((61, 83), 3, k) * 0.01 + 1 - k for k in (0, 1)]
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
    return _core.blur_motion(f(4, 4, 3), f(*lit) > 0, (f(*motion), 4), (0.1, 0.1, 1.0), 1.0)


def table(f) -> _core.RayTable:
    return _core.RayTable(f(4, 4, 3))


@pytest.mark.parametrize(
    ("call", "match"),
    [
        (lambda f: _core.to_planes(f(4, 4, 2), 1.0), "image must be"),
        (lambda f: blur(f, (4, 5), (1, 1, 2)), "fit"),
        (lambda f: blur(f, (4, 4), (1, 1, 3)), "Motion"),
        (lambda f: _core.defocus(f(3, 4, 4), f(4, 5), 1.0, 1.0), "Distances"),
        (lambda f: _core.defocus(f(2, 4, 4), f(4, 4), 1.0, 1.0), "Planes must"),
        (lambda f: _core.shade_planes(f(3, 4, 4), f(4, 5)), "A map"),
        (lambda f: _core.flow_by_rays(table(f), f(1, 1, 2).astype(float), np.eye(4), 4), "shape"),
        (lambda f: _core.flow_by_rays(table(f), f(2, 2, 3).astype(float), np.eye(4), 4), "fit"),
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
