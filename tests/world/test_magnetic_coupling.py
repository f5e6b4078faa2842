"""Sources outside that pull at the capsule in `World.step`, against closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ellipk

from tests.support.tubes import bent_tube
from vrcaps.capsule.device_file import read_device
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import matrix_from_quaternion, rotate_vectors, transform_from
from vrcaps.magnet.field import field, wrench
from vrcaps.magnet.sources import (
    MAGNETIC_CONSTANT,
    Coil,
    Cylinder,
    Dipole,
    InternalMagnet,
    UniformField,
    magnet_pose,
)
from vrcaps.tissue.tissue import Drag, Tissue
from vrcaps.world.control import GRAVITY, Control
from vrcaps.world.model import Model, State, posture_transform
from vrcaps.world.world import World

FREE = Tissue(deformation=None, drag=Drag(friction=0.0))
HOVER = np.eye(3)


@pytest.fixture(scope="module")
def wide(tube):
    """A tube so wide that nothing touches the capsule."""
    return bent_tube(radius=0.04, around=24, along=60)


def make_world(organ, moment, sources, *, wxyz_z=(0, 0, 1), at=0.05, offset=(0, 0, 0), **options):
    """A capsule with one magnet, its axis along `wxyz_z`, on the centerline of `organ`."""
    device = read_device("mirocam")
    device = replace(device, magnets=(InternalMagnet(offset, moment),))
    model = Model(organ, device, options.pop("T_world_patient", posture_transform("supine")))
    index = int(np.argmin(np.abs(organ.centerline.arc_length - at)))
    place = (model.T_world_patient @ [*organ.centerline.points[index], 1.0])[:3]
    pose = magnet_pose(place, wxyz_z)
    options.setdefault("tissue", FREE)
    tissue = options.pop("tissue")
    return World(model, tissue, State(0.0, pose), sources=sources, **options)


def lifted(world) -> Control:
    """Gravity balanced by a commanded force."""
    return Control(force_world=(0.0, 0.0, world.body.mass * GRAVITY))


def test_falls_towards_a_dipole(wide):
    """Coaxial dipoles from rest: ½ M v² = μ₀ m₁ m₂/2π (1/r³ − 1/r₀³)."""
    m1, m2, r0 = 100.0, 0.5, 0.2
    world = make_world(wide, (0, 0, m2), [])
    above = world.T_world_capsule[:3, 3] + [0, 0, r0]
    world = make_world(wide, (0, 0, m2), [Dipole(m1, magnet_pose(above, (0, 0, 1)))])
    control = lifted(world)
    for _ in range(4):
        world.step(control, 0.02)
    r = above[2] - world.T_world_capsule[2, 3]
    assert r < r0 - 0.01
    gained = MAGNETIC_CONSTANT * m1 * m2 / (2 * np.pi) * (1 / r**3 - 1 / r0**3)
    speed = world.state.linear_velocity_world[2]
    assert 0.5 * world.body.mass * speed**2 == pytest.approx(gained, rel=1e-5)


def test_swings_like_a_pendulum_and_keeps_its_energy(wide):
    """In an even field θ̈ = −(mB/I) sin θ: period 4 √(I/mB) K(sin θ₀/2), for many swings."""
    m, flux, tilt = 0.2, 0.05, 1.0
    axis = (np.sin(tilt), 0.0, np.cos(tilt))
    world = make_world(wide, (0, 0, m), [UniformField(flux)], wxyz_z=axis)
    inertia = world.body.inertia[0, 0]
    period = 4.0 * np.sqrt(inertia / (m * flux)) * ellipk(np.sin(tilt / 2) ** 2)
    control = lifted(world)

    def energy() -> float:
        state = world.state
        spin = state.angular_velocity_world
        return 0.5 * inertia * spin @ spin - m * flux * state.T_world_capsule[2, 2]

    start = energy()
    for _ in range(50):
        world.step(control, period)
        assert energy() == pytest.approx(start, abs=2e-3 * m * flux)
    angle = np.arctan2(*world.T_world_capsule[[0, 2], 2])
    assert angle == pytest.approx(tilt, abs=0.15)  # in phase after 50 swings
    assert world.coupling.angle == pytest.approx(angle, abs=1e-9)


@pytest.mark.slow
def test_torque_aligns_where_something_damps(wide):
    """A capsule that turns in mucus ends along the field."""
    damped = Tissue(deformation=None, drag=Drag(friction=0.02, viscosity=0.5))
    world = make_world(wide, (0, 0, 0.2), [UniformField(0.02, magnet_pose((0, 0, 0), (1, 0, 0)))],
                       tissue=damped, wxyz_z=(0.3, 0.2, 1.0))  # fmt: skip
    for _ in range(8):
        world.step(Control(), 0.25)
    coupling = world.coupling
    assert coupling.angle < 0.15
    np.testing.assert_allclose(coupling.flux_density_world, [0.02, 0, 0], atol=1e-12)
    assert np.linalg.norm(coupling.force_world) < 1e-12
    assert coupling.distance == np.inf


def test_momentum_is_the_impulse_of_mean_force(wide):
    """M Δv = (mean magnetic force + commanded + weight) Δt, sources on their way meanwhile."""
    world = make_world(wide, (0.1, 0, 0.3), [])
    at = world.T_world_capsule[:3, 3]
    sources = [
        Cylinder(0.05, 0.05, 1.4, magnet_pose(at + np.array([0.1, 0.05, 0.15]), (0, 1, 1))),
        Coil(0.1, 20.0, 50, magnet_pose(at + np.array([0, -0.2, 0]), (0, 1, 0))),
    ]
    world = make_world(wide, (0.1, 0, 0.3), sources, offset=(1e-3, 0, -2e-3))
    poses = np.array(
        [magnet_pose(at + np.array([0.05, 0.1, 0.15]), (1, 0, 1)), magnet_pose(at, (1, 0, 0))]
    )
    poses[1, :3, 3] = at + np.array([0.2, 0, 0])
    control = replace(lifted(world), Ts_world_magnet=poses, strengths=np.array([1.0, -0.5]))
    world.step(control, 0.1)
    state, coupling = world.state, world.coupling
    np.testing.assert_allclose(
        world.body.mass * state.linear_velocity_world, 0.1 * coupling.force_world, rtol=1e-9
    )
    np.testing.assert_allclose(coupling.Ts_world_magnet, poses, atol=1e-12)
    np.testing.assert_allclose(coupling.strengths, [1.0, -0.5])
    assert np.linalg.norm(coupling.force_world) > 1e-3


@pytest.mark.parametrize("posture", ["supine", "left-lateral"])
def test_wrench_is_that_of_the_field(wide, posture):
    """One short step against `vrcaps.magnet.field.wrench`, however the patient lies."""
    turned = posture_transform(posture)
    turned[:3, 3] = [0.1, -0.2, 0.3]
    options = {"T_world_patient": turned, "wxyz_z": (1, 2, 2), "offset": (0, 1e-3, -3e-3)}
    at = make_world(wide, (0, 0, 1), [], **options).T_world_capsule
    source = Cylinder(0.1016, 0.1016, 1.48, magnet_pose(at[:3, 3] + [0.02, 0.05, 0.2], (1, 0, 1)))
    world = make_world(wide, (0.1, 0.2, 1), [source], **options)
    world.step(Control(), 1e-7)
    force, torque = wrench([source], world.model.device.magnets, at)
    np.testing.assert_allclose(world.coupling.force_world, force, rtol=1e-6)
    np.testing.assert_allclose(world.coupling.torque_world, torque, rtol=1e-6)


def test_the_field_told_is_that_amid_the_magnets(wide):
    """At their middle by the size of their moments; the angle is that of the moments' sum."""
    places = np.array([(0, 1e-3, 4e-3), (0, 0, -5e-3)])
    moments = np.array([(0, 0.1, 0.3), (1, 0, 0)])
    pairs = zip(places, moments, strict=True)
    magnets = tuple(InternalMagnet(tuple(place), tuple(moment)) for place, moment in pairs)
    bare = make_world(wide, (0, 0, 1), [], wxyz_z=(1, 2, 2))
    T, device = bare.T_world_capsule, replace(bare.model.device, magnets=magnets)
    source = Cylinder(0.1016, 0.1016, 1.48, magnet_pose(T[:3, 3] + [0.02, 0.05, 0.2], (1, 0, 1)))
    model = Model(wide, device, bare.model.T_world_patient)
    world = World(model, FREE, State(0.0, T), sources=[source])
    middle = np.average(places, axis=0, weights=np.linalg.norm(moments, axis=1))
    point = T[:3, :3] @ middle + T[:3, 3]
    flux = field([source], point[None])[0][0]
    moment = T[:3, :3] @ moments.sum(axis=0)
    cosine = moment @ flux / np.linalg.norm(moment) / np.linalg.norm(flux)
    np.testing.assert_allclose(world.coupling.flux_density_world, flux, rtol=1e-9)
    assert world.coupling.angle == pytest.approx(np.arccos(cosine), rel=1e-9)
    assert world.field_angle(T) == world.coupling.angle
    away = np.linalg.norm(point - source.T_world_magnet[:3, 3])
    assert world.coupling.distance == pytest.approx(away, rel=1e-9)


def test_a_patient_who_turns_leaves_the_sources(wide):
    """The sources stand in the world: on a turned patient they act from another side."""
    world = make_world(wide, (0, 0, 0.3), [UniformField(0.01, magnet_pose((0, 0, 0), (1, 0, 0)))])
    left = posture_transform("left-lateral")
    world.step(Control(T_world_patient=left), 1e-6)
    np.testing.assert_allclose(world.coupling.flux_density_world, [0.01, 0, 0], atol=1e-15)
    moment = rotate_vectors(world.T_world_capsule, np.array([0, 0, 0.3]))
    expected = np.cross(moment, [0.01, 0, 0])
    np.testing.assert_allclose(world.coupling.torque_world, expected, atol=1e-9)


def test_pulls_the_capsule_onto_the_wall(tube):
    """In a real tube the wall bears what magnet and gravity leave: equilibrium of mean forces."""
    damped = Tissue(deformation=None, drag=Drag(viscosity=1.0))
    world = make_world(tube, (0, 0, 1.12), [], tissue=damped)
    above = world.T_world_capsule[:3, 3] + [0, 0, 0.22]
    world = make_world(tube, (0, 0, 1.12), [Dipole(970.0, magnet_pose(above, (0, 0, 1)))],
                       tissue=damped, substep=2e-4)  # fmt: skip
    for _ in range(6):
        world.step(Control(), 0.25)
    left = world.coupling.force_world + world.contact.force_world
    left[2] -= world.body.mass * GRAVITY
    assert np.linalg.norm(left) < 0.02 * np.linalg.norm(world.contact.force_world)


def test_snapshot_holds_the_sources(wide):
    def begin() -> World:
        return make_world(
            wide, (0, 0, 0.3), [Dipole(50.0, magnet_pose((0.2, 0.0, 0.2), (0, 1, 0)))]
        )

    control = Control(Ts_world_magnet=[magnet_pose((0.25, 0.1, 0.2), (0, 1, 1))])
    one, other = begin(), begin()
    one.step(control, 0.02)
    middle = one.snapshot()
    one.step(Control(), 0.02)
    other.restore(middle)
    other.step(Control(), 0.02)
    for key, value in vars(one.snapshot()).items():
        np.testing.assert_array_equal(value, getattr(other.snapshot(), key), err_msg=key)


def test_what_cannot_be(wide):
    world = make_world(
        wide, (0, 0, 0.3), [Cylinder(0.03, 0.03, 1.4, magnet_pose((1, 0, 0), (0, 0, 1)))]
    )
    before, at = world.snapshot(), world.T_world_capsule[:3, 3]
    onto = magnet_pose(at + np.array([0.0, 0.0, 0.015]), (0, 0, 1))
    with pytest.raises(InputError, match="A magnet outside cuts the capsule"):
        world.step(Control(Ts_world_magnet=[onto]), 0.05)
    for key, value in vars(before).items():
        np.testing.assert_array_equal(value, getattr(world.snapshot(), key), err_msg=key)
    with pytest.raises(InputError, match="Number of the control's Ts_world_magnet is 2"):
        world.step(Control(Ts_world_magnet=[onto, onto]), 0.05)
    with pytest.raises(InputError, match="Number of the control's strengths is 3"):
        world.step(Control(strengths=np.ones(3)), 0.05)
    with pytest.raises(InputError, match="not a rigid pose"):
        Control(Ts_world_magnet=[2.0 * onto])
    with pytest.raises(InputError, match="strengths are"):
        Control(strengths=np.array([np.nan]))
    with pytest.raises(InputError, match="contains no magnet"):
        World(
            Model(wide, read_device("mirocam")),
            FREE,
            State(0.0, transform_from(HOVER, at)),
            sources=[UniformField(0.01)],
        )
    dipole = make_world(wide, (0, 0, 0.3), [Dipole(1e-9, magnet_pose(at, (0, 0, 1)))])
    with pytest.raises(InputError, match="comes into a dipole"):
        dipole.step(lifted(dipole), 0.001)


def test_the_pose_is_that_of_the_patient_and_the_capsule_in_it(wide):
    """T_world_capsule = T_world_patient T_patient_capsule, also once the patient has turned."""
    world = make_world(wide, (0, 0, 1.0), [], wxyz_z=(1, 2, 3), T_world_patient=np.eye(4))
    for posture in ("supine", "left-lateral"):
        world.step(replace(lifted(world), T_world_patient=posture_transform(posture)), 0.01)
        place, wxyz = np.split(world.snapshot().capsule[:7], [3])
        inner = transform_from(matrix_from_quaternion(wxyz), place + world._center)
        outer = posture_transform(posture)
        np.testing.assert_allclose(world.T_world_capsule, outer @ inner, atol=1e-15)
