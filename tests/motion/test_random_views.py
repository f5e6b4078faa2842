from dataclasses import replace

import numpy as np
import pytest

from tests.support.tubes import straight_tube
from vrcaps.capsule.device_file import read_device
from vrcaps.core.errors import InputError
from vrcaps.core.units import DEG, MM
from vrcaps.motion.random_views import RandomViews, _cone
from vrcaps.organ.surface import CLOSED_RADIUS
from vrcaps.world.model import Model

STRAIGHT = RandomViews(tilt=0.0, nearest=5.0 * MM, farthest=40.0 * MM, obliqueness=60.0 * DEG)


def begun(model, settings, *, frames=60, seed=0):
    return settings.begin(model, frames=frames, fps=5.0, seed=seed)


def first_cameras(model, trajectory):
    camera = model.device.cameras[0]
    return trajectory.Ts_world_capsule @ camera.T_capsule_camera


def seen_along_the_axis(model, trajectory):
    """Distance [m] and face of what each first camera's axis meets."""
    poses = first_cameras(model, trajectory)
    return model.wall.cast(poses[:, :3, 3].copy(), poses[:, :3, 2].copy())


@pytest.fixture
def spotted(model):
    """The tube with two lesions a quarter of its way from each end, each of some vertices."""
    organ = model.organ
    instance = np.zeros(len(organ.vertices), np.uint16)
    for number, part in ((1, 0.25), (2, 0.75)):
        place = part * organ.centerline.length
        is_near = np.abs(organ.arc_length - place) < 4.0 * MM
        instance[is_near & (np.abs(organ.theta) < 0.4)] = number
        assert np.count_nonzero(instance == number) >= 5
    return Model(replace(organ, instance=instance), model.device)


def lesion_of_face(model, faces):
    return model.organ.instance[model.organ.faces[faces]].max(axis=1)


def test_views_are_free_and_at_rest(model):
    settings = RandomViews(margin=3.0 * MM)
    trajectory = begun(model, settings, frames=200)
    assert model.vital_clearance(trajectory.Ts_world_capsule).min() >= 0.999 * settings.margin
    assert model.clearance(trajectory.Ts_world_capsule).min() > 0.0
    assert not trajectory.linear_velocities_world.any()
    assert not trajectory.angular_velocities_world.any()
    assert len(np.unique(trajectory.Ts_world_capsule[:, :3, 3], axis=0)) == 200


def test_the_body_does_not_pass_through_a_fold():
    organ = straight_tube(0.1, 10 * MM, 32, 201)
    shelf = np.exp(-(((organ.arc_length - 0.05) / (1.5 * MM)) ** 2)) * (np.cos(organ.theta) > 0.0)
    narrower = np.stack([1.0 - 0.9 * shelf, 1.0 - 0.9 * shelf, np.ones_like(shelf)], axis=1)
    organ = replace(organ, vertices=organ.vertices * narrower)
    narrow = Model(organ, read_device("pillcam-colon2"), np.eye(4))
    settings = RandomViews(margin=0.5 * MM, nearest=4.0 * MM, farthest=20.0 * MM)
    poses = begun(narrow, settings, frames=200).Ts_world_capsule
    along = np.linspace(-1.0, 1.0, 33) * (narrow.device.length / 2.0 - narrow.device.radius)
    points = poses[:, None, :3, 3] + along[:, None] * poses[:, None, :3, 2]
    outside = np.asarray(narrow.wall.signed_distance(points.reshape(-1, 3))) < -0.5 * MM
    assert not outside.any()


def test_the_wall_is_seen_at_the_distance_and_angle_asked_for(model):
    trajectory = begun(model, STRAIGHT, frames=300)
    distance, faces = seen_along_the_axis(model, trajectory)
    slack = 0.6 * MM
    assert distance.min() > STRAIGHT.nearest - slack
    assert distance.max() < STRAIGHT.farthest + slack
    corners = model.vertices_world[model.organ.faces[faces]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    axes = first_cameras(model, trajectory)[:, :3, 2]
    angle = np.degrees(np.arccos(-(normals * axes).sum(axis=1)))
    assert angle.max() < 60.0 + 5.0  # facets are flat, normals of vertices are not
    assert np.quantile(angle, 0.9) > 35.0


def test_directions_are_even_within_a_cone():
    """Over a cap of the sphere up to the angle a the mean cosine is (1 + cos a) / 2."""
    axes = np.tile([0.0, 0.6, 0.8], (20_000, 1))
    drawn = _cone(axes, 40.0 * DEG, np.random.default_rng(0))
    np.testing.assert_allclose(np.linalg.norm(drawn, axis=1), 1.0)
    cosine = (drawn * axes).sum(axis=1)
    assert cosine.min() >= np.cos(40.0 * DEG) - 1e-12
    assert cosine.mean() == pytest.approx(0.5 * (1.0 + np.cos(40.0 * DEG)), abs=2e-3)
    np.testing.assert_allclose(drawn.mean(axis=0), cosine.mean() * axes[0], atol=5e-3)


def test_images_are_tilted_and_rolled(model):
    """The axis misses its target where it is tilted; image rows point everywhere."""
    settings = replace(STRAIGHT, tilt=40.0 * DEG, farthest=8.0 * MM)
    tilted = begun(model, settings, frames=400)
    assert seen_along_the_axis(model, tilted)[0].max() > settings.farthest + 2.0 * MM
    assert np.abs(first_cameras(model, tilted)[:, :3, 0].mean(axis=0)).max() < 0.15


def test_lesions_are_looked_at_all_alike(spotted):
    settings = replace(STRAIGHT, lesion_fraction=1.0)
    _, faces = seen_along_the_axis(spotted, begun(spotted, settings, frames=200))
    shown = lesion_of_face(spotted, faces)
    assert np.count_nonzero(shown) >= 195  # a ray to a rim may meet the face beside it
    assert 70 <= np.count_nonzero(shown == 1) <= 130


@pytest.mark.parametrize(("fraction", "low", "high"), [(0.0, 0, 10), (0.5, 75, 125)])
def test_a_fraction_of_the_views_is_of_lesions(spotted, fraction, low, high):
    settings = replace(STRAIGHT, lesion_fraction=fraction)
    _, faces = seen_along_the_axis(spotted, begun(spotted, settings, frames=200))
    assert low <= np.count_nonzero(lesion_of_face(spotted, faces)) <= high


def test_a_seed_draws_the_same_views(model):
    first, again, other = (begun(model, RandomViews(), seed=seed) for seed in (3, 3, 4))
    assert first.Ts_world_capsule.tobytes() == again.Ts_world_capsule.tobytes()
    assert not np.allclose(first.Ts_world_capsule, other.Ts_world_capsule)


def test_the_wall_makes_way_unless_it_is_rigid(model):
    assert begun(model, RandomViews(), frames=1).wall_displacement is not None
    assert begun(model, RandomViews(rigid_wall=True), frames=1).wall_displacement is None


def test_a_refusal_states_the_limits_of_a_closed_lumen():
    organ = replace(straight_tube(0.05, 0.4 * MM, 12, 51), metadata={CLOSED_RADIUS: 0.1 * MM})
    narrow = Model(organ, read_device("mirocam"), np.eye(4))
    with pytest.raises(InputError, match=r"with nearest 0\.004 m and margin 0\.0005 m"):
        begun(narrow, RandomViews(), frames=1)


def test_views_without_a_place_are_refused(model):
    far = RandomViews(nearest=0.5, farthest=0.6)
    with pytest.raises(InputError, match=r"3 of 3 views have no free position.*Allow less of both"):
        begun(model, far, frames=3)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"nearest": 0.05, "farthest": 0.01}, "farthest is 0.01. Allowed: nearest"),
        ({"lesion_fraction": 1.5}, "lesion_fraction"),
        ({"obliqueness": 1.6}, "obliqueness"),
        ({"margin": 0.0}, "margin"),
    ],
)
def test_settings_out_of_range_are_refused(fields, message):
    with pytest.raises(InputError, match=message):
        RandomViews(**fields)
