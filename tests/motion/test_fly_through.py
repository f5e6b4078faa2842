from dataclasses import replace

import numpy as np
import pytest

from tests.support.tubes import straight_tube
from vrcaps.capsule.device_file import device_names, read_device
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import transform_points
from vrcaps.core.units import MM
from vrcaps.motion.fly_through import FlyThrough, _free_part, fly_through
from vrcaps.organ.surface import CLOSED_RADIUS
from vrcaps.world.model import Model


def _fly(model, settings=None, *, frames=80, fps=10.0, seed=0):
    rng = np.random.default_rng(seed)
    return fly_through(model, settings or FlyThrough(whole=True), frames=frames, fps=fps, rng=rng)


def _forward(trajectory):
    return trajectory.Ts_world_capsule[:, :3, 2]


@pytest.mark.slow
@pytest.mark.parametrize("device", device_names())
def test_every_device_stays_inside(tube, device):
    """Center and cameras of every catalog device keep clear of the wall, whatever the seed."""
    model = Model(tube, read_device(device))
    wild = FlyThrough(whole=True, drift=0.95, tilt=0.7, roll=3.0)
    for seed, settings in ((0, FlyThrough(whole=True)), (2, replace(wild, start=0.9, end=0.1))):
        trajectory = _fly(model, settings, seed=seed)
        assert model.vital_clearance(trajectory.Ts_world_capsule).min() > 0.0
        assert model.wall.signed_distance(trajectory.Ts_world_capsule[:, :3, 3]).min() > 0.0
        Ts = trajectory.Ts_world_capsule
        identity = Ts[:, :3, :3] @ np.swapaxes(Ts[:, :3, :3], 1, 2)
        np.testing.assert_allclose(identity, np.broadcast_to(np.eye(3), (80, 3, 3)), atol=1e-9)
        assert np.linalg.det(Ts[:, :3, :3]).min() > 0.999


def test_margin_is_kept_where_there_is_room(model):
    """With a drift of nearly the whole radius the margin still holds away from the ends."""
    settings = FlyThrough(start=0.2, end=0.8, whole=True, drift=0.98, tilt=0.6, margin=0.004)
    trajectory = _fly(model, settings, frames=400)
    assert model.vital_clearance(trajectory.Ts_world_capsule).min() > 0.98 * 0.004


def test_without_wandering_it_rides_the_centerline(model):
    """Both ends of the follower_offsets are on the curve; on the straight so is the whole axis."""
    settings = FlyThrough(whole=True, drift=0.0, tilt=0.0, roll=0.0, speed_variation=0.0)
    trajectory = _fly(model, settings, frames=300)
    camera = model.device.cameras[0]
    front = (trajectory.Ts_world_capsule @ camera.T_capsule_camera)[:, :3, 3]
    line = transform_points(model.T_world_patient, model.organ.centerline.points)
    distance = np.linalg.norm(front[:, None] - line[None], axis=-1).min(axis=1)
    assert distance.max() < 1e-3  # half the sampling of the polyline
    speed = np.linalg.norm(trajectory.linear_velocities_world, axis=1)
    assert np.ptp(speed) < 0.2 * speed.mean()


@pytest.mark.slow
def test_camera_looks_along_the_travel(model):
    trajectory = _fly(model, FlyThrough(whole=True, tilt=0.1, drift=0.2), frames=200)
    velocity = trajectory.linear_velocities_world
    velocity = velocity / np.linalg.norm(velocity, axis=1, keepdims=True)
    assert (velocity * _forward(trajectory)).sum(axis=1).min() > np.cos(0.5)
    back = _fly(model, FlyThrough(start=0.9, end=0.1, whole=True, tilt=0.1, drift=0.2), frames=200)
    heading = _forward(back) * back.linear_velocities_world
    assert (heading.sum(axis=1) > 0.0).all()


@pytest.mark.slow
def test_velocities_are_derivatives_of_the_poses(model):
    """Differences of a finer sampling of the same path converge to the velocities given."""
    settings = FlyThrough(speed=0.02)
    coarse = _fly(model, settings, frames=11, fps=2.0)
    fine = _fly(model, settings, frames=1001, fps=200.0)
    np.testing.assert_allclose(
        coarse.Ts_world_capsule, fine.Ts_world_capsule[::100], rtol=0, atol=1e-9
    )
    step = fine.Ts_world_capsule[1:, :3, 3] - fine.Ts_world_capsule[:-1, :3, 3]
    middle = 0.5 * (fine.linear_velocities_world[1:] + fine.linear_velocities_world[:-1])
    np.testing.assert_allclose(step * 200.0, middle, atol=2e-4)


@pytest.mark.slow
def test_path_does_not_depend_on_the_frame_rate(model):
    slow, fast = _fly(model, frames=21, fps=5.0), _fly(model, frames=41, fps=10.0)
    np.testing.assert_allclose(slow.Ts_world_capsule, fast.Ts_world_capsule[::2], rtol=0, atol=1e-9)


def test_motion_is_smooth(model):
    """No step of the heading between frames exceeds what the mean turn allows ten times over."""
    trajectory = _fly(model, FlyThrough(whole=True, drift=0.9, tilt=0.5), frames=600, fps=20.0)
    turn = np.arccos(np.clip((_forward(trajectory)[1:] * _forward(trajectory)[:-1]).sum(1), -1, 1))
    assert turn.max() < 10.0 * max(turn.mean(), 1e-3)


@pytest.mark.slow
def test_same_seed_same_path_other_seed_other_path(model):
    first, again, other = _fly(model, seed=3), _fly(model, seed=3), _fly(model, seed=4)
    assert first.Ts_world_capsule.tobytes() == again.Ts_world_capsule.tobytes()
    assert np.abs(first.Ts_world_capsule - other.Ts_world_capsule).max() > 1e-3


def test_mean_speed_and_variation(model):
    """The distance covered is speed × time; momentary speed stays near 1 ± variation."""
    settings = FlyThrough(speed=0.03, speed_variation=0.5, drift=0.0, tilt=0.0, start=0.1)
    trajectory = _fly(model, settings, frames=60, fps=10.0)
    speed = np.linalg.norm(trajectory.linear_velocities_world, axis=1)
    assert speed.mean() == pytest.approx(0.03, rel=0.2)
    assert 0.03 * 0.3 < speed.min() < 0.028
    assert 0.032 < speed.max() < 0.03 * 1.9


def test_default_speed_is_a_centimeter_a_second_or_what_the_stretch_allows(model):
    """9.9 s at 0.01 m/s travel 99 mm; 99 s would need more than the tube, which is covered."""
    still = {"speed_variation": 0.0, "drift": 0.0, "tilt": 0.0, "roll": 0.0}
    camera = model.device.cameras[0]

    def traveled(settings: FlyThrough, frames: int) -> float:
        poses = _fly(model, settings, frames=frames).Ts_world_capsule
        front = (poses @ camera.T_capsule_camera)[:, :3, 3]
        return float(np.linalg.norm(np.diff(front, axis=0), axis=1).sum())

    assert traveled(FlyThrough(**still), 100) == pytest.approx(0.099, rel=0.02)
    whole = traveled(FlyThrough(whole=True, **still), 100)
    assert whole > 0.25
    assert traveled(FlyThrough(**still), 1000) == pytest.approx(whole, rel=0.02)


def test_whole_and_a_speed_exclude_each_other():
    with pytest.raises(InputError, match=r"whole is true and speed is 0\.01 m/s\. Allowed: one of"):
        FlyThrough(whole=True, speed=0.01)


def test_a_bend_that_is_too_narrow_is_avoided_where_the_flight_is_short():
    """Free from 0 to 4 and 6 to 20 mm at 1 mm spacing: 0.5 s need 5 mm, which only fit behind."""
    knots = 1e-3 * np.arange(21)
    is_free = np.abs(np.arange(21) - 5) > 0
    assert _free_part(FlyThrough(), knots, is_free, 0.5) == pytest.approx((6e-3, 20e-3))
    assert _free_part(FlyThrough(), knots, is_free, 0.3) == pytest.approx((0.0, 4e-3))
    back = FlyThrough(start=0.9, end=0.1)
    assert _free_part(back, knots, is_free, 0.3) == pytest.approx((6e-3, 20e-3))
    assert _free_part(FlyThrough(), knots, is_free, 2.0) is None


def test_one_frame(model):
    trajectory = _fly(model, frames=1)
    assert len(trajectory) == 1
    np.testing.assert_array_equal(trajectory.linear_velocities_world, 0.0)


def test_too_far_for_the_stretch(model):
    with pytest.raises(InputError, match=r"the stretch is 0\.3.* m\. Allowed: up to \d+ frames"):
        _fly(model, FlyThrough(speed=0.1), frames=100, fps=10.0)


def test_capsule_that_fits_nowhere(model):
    camera = model.device.cameras[0]
    mount = camera.T_capsule_camera.copy()
    mount[0, 3] = 0.5
    device = replace(model.device, length=1.2, radius=0.6, cameras=(camera.at(mount),))
    with pytest.raises(InputError, match=r"nowhere between start .* capsule 1200\.0 mm thick\. Ch"):
        _fly(Model(model.organ, device))
    organ = replace(model.organ, metadata={"unit": "m"})
    with pytest.raises(InputError, match=r"mm thick\. Choose"):
        _fly(Model(organ, device))


@pytest.mark.slow
def test_capsule_too_long_for_a_bend(model, monkeypatch):
    monkeypatch.setattr("vrcaps.motion.centerline_follower._MAX_PUSHES", 10)  # of them none helps
    device = replace(model.device, length=0.25, radius=0.06)
    with pytest.raises(InputError, match=r"a camera leaves the lumen 0\.\d+ of the way along"):
        _fly(Model(model.organ, device))


def _constricted(closed: float) -> Model:
    """Straight tube with a ring in its middle that is narrower than the circle of side cameras."""
    organ = straight_tube(0.2, 8 * MM, 32, 201)
    device = read_device("panoramic")
    side = max(float(np.hypot(*camera.position[:2])) for camera in device.cameras)
    ring = np.exp(-(((organ.arc_length - 0.1) / (3 * MM)) ** 2))
    scale = 1.0 - ring * (1.0 - (side - 0.3 * MM) / (8 * MM))
    vertices = organ.vertices * np.stack([scale, scale, np.ones_like(scale)], axis=1)
    organ = replace(organ, vertices=vertices, metadata={CLOSED_RADIUS: closed})
    return Model(organ, device, np.eye(4))


@pytest.mark.parametrize(("closed", "usual"), [(0.0, (0.1, 0.5)), (2 * MM, (0.5, 0.95))])
def test_a_capsule_in_a_slack_lumen_is_often_near_its_maximum_tilt(closed, usual):
    organ = replace(straight_tube(0.6, 20 * MM, 32, 301), metadata={CLOSED_RADIUS: closed})
    model = Model(organ, read_device("mirocam"), np.eye(4))
    settings = FlyThrough(whole=True, drift=0.0, tilt=0.6)
    forward = _forward(_fly(model, settings, frames=200))
    angle = np.arccos(np.abs(forward @ organ.centerline.frames[0][:, 2]))
    assert angle.max() <= 0.6
    assert usual[0] < np.median(angle) / 0.6 < usual[1]


def test_a_slack_wall_gives_way_to_cameras_in_the_shell(monkeypatch):
    monkeypatch.setattr("vrcaps.motion.centerline_follower._MAX_PUSHES", 10)
    settings = FlyThrough(start=0.4, end=0.6, whole=True, drift=0.0)
    for model, rigid in ((_constricted(0.0), False), (_constricted(2 * MM), True)):
        with pytest.raises(InputError, match="a camera leaves the lumen"):
            _fly(model, replace(settings, rigid_wall=rigid))
    model = _constricted(2 * MM)
    trajectory = _fly(model, settings)
    poses = trajectory.Ts_world_capsule
    clearance = model.vital_clearance(poses)
    assert -1.0 * MM < clearance.min() < 0.0
    pose = poses[clearance.argmin()]
    wall = trajectory.wall_displacement.vertices_world(pose)
    local = (wall - pose[:3, 3]) @ pose[:3, :3]
    half = 0.5 * model.device.length - model.device.radius
    local[:, 2] -= np.clip(local[:, 2], -half, half)
    assert np.linalg.norm(local, axis=1).min() > 0.999 * model.device.radius


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"start": -0.1}, r"start is -0\.1\. Allowed: 0 to 1"),
        ({"end": 0.03}, r"end is 0.03. Allowed: 0 to 1, not start"),
        ({"speed": 0.0}, r"speed is 0.0. Allowed: above 0 m/s"),
        ({"speed_variation": 1.0}, r"speed_variation is 1.0"),
        ({"drift": 1.0}, r"drift is 1.0"),
        ({"tilt": 2.0}, r"tilt is 2.0"),
        ({"roll": float("nan")}, r"roll is nan"),
        ({"smoothness": 0.0}, r"smoothness is 0.0"),
        ({"margin": -1.0}, r"margin is -1.0"),
    ],
)
def test_settings_out_of_range(model, change, text):
    with pytest.raises(InputError, match=text):
        _fly(model, replace(FlyThrough(), **change))
