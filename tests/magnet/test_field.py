"""Fields against closed forms, against magpylib, and against the laws they must obey."""

from __future__ import annotations

import re

import magpylib
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.support.programs import run_program
from tests.support.scenes import random_directions, random_poses, relative
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import invert, rotate_vectors, transform_points
from vrcaps.magnet.field import SourceSet, field
from vrcaps.magnet.sources import (
    MAGNETIC_CONSTANT,
    Block,
    Coil,
    Cylinder,
    Dipole,
    InternalMagnet,
    Ring,
    Solenoid,
    Source,
    Sphere,
    UniformField,
    magnet_pose,
)

MU0 = MAGNETIC_CONSTANT
ACROSS = np.array([[0, 0, 1], [0, -1, 0], [1, 0, 0]])
"""Frame of magpylib's cylinder, axis z and moment x, in ours, axis x and moment z."""
SHAPES = ("cylinder across", "rod across", "ring", "ring across", "block", "sphere")
LOCAL: dict[str, Source] = {
    "dipole": Dipole(970.0),
    "cylinder": Cylinder(0.1, 0.1, 1.48),
    "disc": Cylinder(0.1, 0.004, 1.2),
    "rod": Cylinder(0.01, 0.1, 1.3),
    "cylinder across": Cylinder(0.1, 0.06, 1.48, magnetization="diametric"),
    "rod across": Cylinder(0.02, 0.11, 1.3, magnetization="diametric"),
    "ring": Ring(0.1, 0.06, 0.03, 1.2),
    "ring across": Ring(0.1, 0.06, 0.03, 1.2, magnetization="diametric"),
    "block": Block((0.04, 0.06, 0.03), 1.3),
    "sphere": Sphere(0.06, 1.4),
    "coil": Coil(0.05, 12.0, 100),
    "solenoid": Solenoid(0.05, 0.08, 10.0, 300),
    "thick solenoid": Solenoid(0.05, 0.08, 10.0, 300, thickness=0.02, layers=5),
}


def placed(source: Source, pose: np.ndarray) -> Source:
    return type(source)(**{**source.__dict__, "T_world_magnet": pose})


def around(rng: np.random.Generator, count: int, *, least: float = 0.06) -> np.ndarray:
    """Places in all directions, from `least` to 10 m, even in the logarithm."""
    return random_directions(rng, count) * np.exp(
        rng.uniform(np.log(least), np.log(10), (count, 1))
    )


def theirs(source: Source) -> magpylib.Collection:
    position, pose = source.T_world_magnet[:3, 3], source.T_world_magnet[:3, :3]
    match source:
        case Dipole():
            made = magpylib.misc.Dipole(moment=(0, 0, source.moment))
        case Cylinder() | Ring():
            is_across = source.magnetization == "diametric"
            along = (source.remanence, 0, 0) if is_across else (0, 0, source.remanence)
            outer, hole = source.diameter, getattr(source, "hole_diameter", 0.0)
            if hole:
                size = (0.5 * hole, 0.5 * outer, source.length, 0, 360)
                made = magpylib.magnet.CylinderSegment(polarization=along, dimension=size)
            else:
                size = (outer, source.length)
                made = magpylib.magnet.Cylinder(polarization=along, dimension=size)
            pose = pose @ (ACROSS if is_across else np.eye(3))
        case Block():
            made = magpylib.magnet.Cuboid(
                polarization=(0, 0, source.remanence), dimension=source.size
            )
        case Sphere():
            made = magpylib.magnet.Sphere(
                polarization=(0, 0, source.remanence), diameter=source.diameter
            )
        case Coil():
            current = source.current * source.turns
            made = magpylib.current.Circle(current=current, diameter=2 * source.radius)
        case Solenoid():
            sheet = MU0 * source.current * source.turns / source.length
            size = (2 * source.radius, source.length)
            made = magpylib.magnet.Cylinder(polarization=(0, 0, sheet), dimension=size)
        case _:
            raise AssertionError(source)
    made.position, made.orientation = position, Rotation.from_matrix(pose)
    return made


def test_dipole_is_the_closed_form():
    """B = μ₀/4π (3 (m·r̂) r̂ − m)/r³ (Jackson 1999, eq. 5.56)."""
    rng = np.random.default_rng(0)
    pose = random_poses(rng, 1)[0]
    points = pose[:3, 3] + around(rng, 1000, least=0.01)
    moment, r = 3.7 * pose[:3, 2], points - pose[:3, 3]
    length = np.linalg.norm(r, axis=1, keepdims=True)
    n = r / length
    expected = MU0 / (4 * np.pi) * (3 * (n @ moment)[:, None] * n - moment) / length**3
    assert relative(field([Dipole(3.7, pose)], points)[0], expected).max() < 1e-12


@pytest.mark.parametrize("name", ["dipole", "cylinder", "disc", "rod", "coil", "solenoid"])
def test_sources_agree_with_magpylib(name):
    """Near, far, inside, beside the axis; its own far field loses digits, so ≤ 2 m here."""
    rng = np.random.default_rng(1)
    pose = random_poses(rng, 1)[0]
    source = placed(LOCAL[name], pose)
    near = rng.uniform(-0.12, 0.12, (5000, 3))
    axis = near * [1e-6, 1e-6, 3.0]
    far = random_directions(rng, 5000) * rng.uniform(0.1, 0.8, (5000, 1))
    points = transform_points(pose, np.concatenate([near, axis, far]))
    flux, gradient = field([source], points)
    assert relative(flux, theirs(source).getB(points)).max() < 1e-9
    assert np.isfinite(gradient).all()


@pytest.mark.parametrize("name", SHAPES)
def test_magnets_of_every_shape_agree_with_magpylib(name):
    """Near, inside, in the hole, at the axis and far, where its own closed forms lose digits."""
    rng = np.random.default_rng(1)
    pose = random_poses(rng, 1)[0]
    source = placed(LOCAL[name], pose)
    near = rng.uniform(-0.08, 0.08, (800, 3))
    axis = rng.uniform(-0.2, 0.2, (200, 3)) * [1.0, 1e-5, 1e-5]
    far = random_directions(rng, 300) * rng.uniform(0.1, 0.6, (300, 1))
    points = transform_points(pose, np.concatenate([near, axis, far]))
    flux, gradient = field([source], points)
    assert relative(flux, theirs(source).getB(points)).max() < 1e-6
    assert np.isfinite(gradient).all()


@pytest.mark.parametrize("name", SHAPES)
def test_the_force_is_the_gradient_of_the_energy(name):
    """F = −∇U with U = −m·B of a dipole that keeps its direction (Jackson 1999, eq. 5.72)."""
    rng = np.random.default_rng(4)
    sources, moment = SourceSet([placed(LOCAL[name], random_poses(rng, 1)[0])]), (0.3, -0.2, 0.9)
    poses = np.tile(np.eye(4), (40, 1, 1))
    poses[:, :3, 3] = sources.sources[0].T_world_magnet[:3, 3] + around(rng, 40, least=0.12)
    force = sources.wrench([InternalMagnet((0.0, 0.0, 0.0), moment)], poses)[0]
    h = 1e-5
    energy = [
        [-(sources.field(poses[:, :3, 3] + s * h * e)[0] @ moment) for s in (1, -1)]
        for e in np.eye(3)
    ]
    slopes = np.array([(up - down) / (2 * h) for up, down in energy]).T
    assert relative(force, -slopes).max() < 1e-6


@pytest.mark.parametrize("name", SHAPES)
def test_the_field_outside_is_the_dipoles_far_away(name):
    points = random_directions(np.random.default_rng(6), 100) * 1000.0
    same = field([Dipole(LOCAL[name].moment)], points)
    for ours, theirs_ in zip(field([LOCAL[name]], points), same, strict=True):
        assert relative(ours.reshape(100, -1), theirs_.reshape(100, -1)).max() < 1e-7


@pytest.mark.parametrize("name", [name for name in LOCAL if name != "sphere"])  # 0 inside
def test_gradient_is_that_of_the_field(name):
    """Richardson's extrapolation of central differences, error O(h⁴)."""
    rng = np.random.default_rng(2)
    pose = random_poses(rng, 1)[0]
    source = placed(LOCAL[name], pose)
    local = np.concatenate([around(rng, 400), around(rng, 100) * [1e-5, 1e-5, 1]])
    points = transform_points(pose, local)
    h = 2e-4 * np.linalg.norm(local, axis=1)[:, None]

    def slope(step: np.ndarray, axis: np.ndarray) -> np.ndarray:
        up, down = (field([source], points + s * step * axis)[0] for s in (1, -1))
        return (up - down) / (2 * step)

    columns = [(4 * slope(h, axis) - slope(2 * h, axis)) / 3 for axis in np.eye(3)]
    expected = np.stack(columns, axis=-1).reshape(-1, 9)
    gradient = field([source], points)[1].reshape(-1, 9)
    assert relative(gradient, expected).max() < 1e-7


@pytest.mark.parametrize("name", LOCAL)
def test_divergence_and_curl_are_zero(name):
    rng = np.random.default_rng(3)
    source = placed(LOCAL[name], random_poses(rng, 1)[0])
    gradient = field([source], around(rng, 2000) + source.T_world_magnet[:3, 3])[1]
    size = np.linalg.norm(gradient, axis=(1, 2))
    assert (np.abs(np.trace(gradient, axis1=1, axis2=2)) / size).max() < 1e-13
    curl = np.linalg.norm(gradient - np.swapaxes(gradient, 1, 2), axis=(1, 2))
    assert (curl / size).max() < 1e-13


def test_cylinder_on_its_axis_inside_and_outside():
    """B = B_r/2 (z₊/√(z₊² + a²) − z₋/√(z₋² + a²))."""
    z, a, b = np.linspace(-0.3, 0.3, 301), 0.04, 0.03
    up, down = z + b, z - b
    expected = 0.5 * 1.3 * (up / np.hypot(up, a) - down / np.hypot(down, a))
    points = np.stack([0 * z, 0 * z, z], axis=1)
    flux, gradient = field([Cylinder(2 * a, 2 * b, 1.3)], points)
    np.testing.assert_allclose(flux[:, 2], expected, rtol=1e-12)
    assert not flux[:, :2].any()
    slope = 0.5 * 1.3 * a**2 * (np.hypot(up, a) ** -3 - np.hypot(down, a) ** -3)
    np.testing.assert_allclose(gradient[:, 2, 2], slope, rtol=1e-11, atol=1e-14)
    np.testing.assert_allclose(gradient[:, 0, 0], -0.5 * slope, rtol=1e-11, atol=1e-14)


def test_coil_on_its_axis():
    """B = μ₀ n I a²/(2 (a² + z²)^{3/2})."""
    z, a = np.linspace(-1.0, 1.0, 200), 0.05
    flux = field([Coil(a, -3.0, 7)], np.stack([0 * z, 0 * z, z], axis=1))[0]
    np.testing.assert_allclose(flux[:, 2], -MU0 * 21 * a**2 / (2 * np.hypot(a, z) ** 3), rtol=1e-12)


def test_long_solenoid_has_the_field_of_its_winding():
    """B = μ₀ n I in the middle, up to (a/L)² (Jackson 1999, problem 5.3)."""
    flux = field([Solenoid(0.01, 2.0, 5.0, 4000)], np.array([[0.003, 0.004, 0.0]]))[0]
    np.testing.assert_allclose(flux[0, 2], MU0 * 4000 / 2.0 * 5.0, rtol=3e-4)


def test_thick_winding_is_between_its_layers_and_keeps_its_moment():
    """m = n I π ⟨a²⟩; with many layers ⟨a²⟩ goes to a² + t²/12."""
    thick = Solenoid(0.05, 0.08, 10.0, 300, thickness=0.03, layers=50)
    mean_square = 0.05**2 + 0.03**2 / 12 * (1 - 1 / 50**2)
    moment = 300 * 10.0 * np.pi * mean_square
    far = np.array([[3.0, 2.0, 25.0]])
    same = field([Dipole(moment)], far)[0]
    assert relative(field([thick], far)[0], same).max() < 1e-4


def test_solenoid_is_the_sum_of_its_loops():
    """A stack of loops is a shell, by the midpoint rule with an error of (pitch/distance)²."""
    rng = np.random.default_rng(4)
    points = around(rng, 50, least=0.12)
    count = 2000
    heights = (np.arange(count) + 0.5) / count * 0.08 - 0.04
    loops = [Coil(0.05, 2.0, 1, magnet_pose((0, 0, z), (0, 0, 1))) for z in heights]
    shell = field([Solenoid(0.05, 0.08, 2.0, count)], points)
    for ours, sum_of_loops in zip(shell, field(loops, points), strict=True):
        assert np.abs(ours - sum_of_loops).max() < 2e-7 * np.abs(ours).max()


@pytest.mark.parametrize("name", ["cylinder", "disc", "rod", "coil", "solenoid"])
def test_no_step_where_the_series_takes_over(name):
    """Closed form and multipole series meet at three times the source's size."""
    source = LOCAL[name]
    size = {"coil": 0.05, "solenoid": np.hypot(0.05, 0.04), "disc": np.hypot(0.05, 0.002)}
    size |= {"cylinder": np.hypot(0.05, 0.05), "rod": np.hypot(0.005, 0.05)}
    directions = random_directions(np.random.default_rng(5), 2000)
    step = 1e-10
    inner = field([source], 3 * size[name] * (1 - step) * directions)
    outer = field([source], 3 * size[name] * (1 + step) * directions)
    for one, other in zip(inner, outer, strict=True):
        assert relative(one.reshape(2000, -1), other.reshape(2000, -1)).max() < 3e-9


def test_cylinder_is_a_dipole_far_away():
    source = LOCAL["rod"]
    points = random_directions(np.random.default_rng(6), 100) * 1000.0
    moment = 1.3 * np.pi * 0.005**2 * 0.1 / MU0
    flux, gradient = field([source], points)
    same = field([Dipole(moment)], points)
    assert relative(flux, same[0]).max() < 1e-7
    assert relative(gradient.reshape(-1, 9), same[1].reshape(-1, 9)).max() < 1e-7


def test_flux_through_a_magnets_skin_is_continuous():
    """B_n is; B_t steps by B_r on the mantle, whose own value is the mean of both sides."""
    source = Cylinder(0.1, 0.06, 1.4)
    gap = 1e-9
    mantle = field(
        [source], np.array([[0.05 - gap, 0, 0.01], [0.05, 0, 0.01], [0.05 + gap, 0, 0.01]])
    )
    inside, on, outside = mantle[0]
    np.testing.assert_allclose(inside[0], outside[0], rtol=1e-5)
    np.testing.assert_allclose(inside[2] - outside[2], 1.4, rtol=1e-5)
    np.testing.assert_allclose(on[2], 0.5 * (inside[2] + outside[2]), rtol=1e-6, atol=1e-7)
    ends = field(
        [source], np.array([[0.02, 0, 0.03 - gap], [0.02, 0, 0.03], [0.02, 0, 0.03 + gap]])
    )
    np.testing.assert_allclose(ends[0][0], ends[0][2], rtol=1e-6)


def test_uniform_field_has_no_gradient():
    flux, gradient = field([UniformField(0.02, magnet_pose((1, 2, 3), (1, 0, -1)))], np.eye(3))
    np.testing.assert_allclose(flux, np.tile([0.02 / np.sqrt(2), 0, -0.02 / np.sqrt(2)], (3, 1)))
    assert not gradient.any()


def test_sources_add_up_and_turn_with_the_world():
    """Superposition, and equivariance under a rigid motion of everything."""
    rng = np.random.default_rng(7)
    poses = random_poses(rng, len(LOCAL), 0.5)
    sources = [placed(s, p) for s, p in zip(LOCAL.values(), poses, strict=True)]
    points = rng.uniform(-1, 1, (200, 3))
    flux, gradient = field(sources, points)
    np.testing.assert_allclose(flux, sum(field([s], points)[0] for s in sources), rtol=1e-13)
    moved = random_poses(rng, 1)[0]
    turned = [placed(s, moved @ s.T_world_magnet) for s in sources]
    flux2, gradient2 = field(turned, transform_points(moved, points))
    np.testing.assert_allclose(flux2, rotate_vectors(moved, flux), atol=1e-12 * np.abs(flux).max())
    rotation = moved[:3, :3]
    expected = rotation @ gradient @ rotation.T
    np.testing.assert_allclose(gradient2, expected, atol=1e-12 * np.abs(gradient).max())


def test_moved_sources_are_where_they_were_put():
    rng = np.random.default_rng(8)
    points = rng.uniform(-1, 1, (20, 3)) + 2.0
    held = SourceSet(list(LOCAL.values()))
    poses = random_poses(rng, len(LOCAL), 0.1)
    for k, pose in enumerate(poses):
        held.move(k, pose)
    fresh = field([placed(s, p) for s, p in zip(LOCAL.values(), poses, strict=True)], points)
    assert np.array_equal(held.field(points)[0], fresh[0])
    assert np.array_equal(held.field(points)[1], fresh[1])


@pytest.mark.slow
def test_same_bytes_with_any_number_of_threads():
    code = (
        "import numpy as np; from vrcaps.magnet.field import field;"
        "from vrcaps.magnet.sources import Coil, Cylinder, Dipole; rng = np.random.default_rng(0);"
        "s = [Cylinder(0.1, 0.1, 1.4), Coil(0.05, 3.0), Dipole(1.0)];"
        "b, g = field(s, rng.uniform(0.1, 1, (2000, 3)));"
        "import hashlib; print(hashlib.sha256(b.tobytes() + g.tobytes()).hexdigest())"
    )
    results = set()
    for threads in ("1", "3"):
        done = run_program(code, environment={"RAYON_NUM_THREADS": threads})
        assert done.returncode == 0, done.stderr
        results.add(done.stdout)
    assert len(results) == 1


@pytest.mark.parametrize("direction", [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0.3, -2, -1e-9)])
def test_magnet_pose_points_where_it_is_told(direction):
    pose = magnet_pose((1, 2, 3), direction)
    np.testing.assert_allclose(pose[:3, 2], np.array(direction) / np.linalg.norm(direction))
    np.testing.assert_allclose(pose @ invert(pose), np.eye(4), atol=1e-15)


@pytest.mark.parametrize(
    ("source", "point", "message"),
    [
        (Dipole(1.0), (0, 0, 0), "Point 0 at [0. 0. 0.] m is in a dipole, on a wire or on the rim"),
        (Coil(0.05, 1.0), (0.03, 0.04, 0), "on a wire or on the rim of a magnet. Move it away."),
        (Cylinder(0.1, 0.2, 1.0), (0.05, 0, -0.1), "on the rim of a magnet. Move it away."),
    ],
)
def test_places_without_a_field(source, point, message):
    with pytest.raises(InputError, match=re.escape(message)):
        field([source], np.array([point], float))
    core = SourceSet([source]).core.field(np.array([point], float))
    assert all(np.isfinite(part).all() for part in core)


def test_points_must_be_finite_rows():
    with pytest.raises(InputError, match=r"Points have shape \(3,\)\. Allowed: n rows of 3 finite"):
        field([Dipole(1.0)], np.zeros(3))
    with pytest.raises(InputError, match=r"Points have shape \(1, 3\)"):
        field([Dipole(1.0)], np.array([[0, np.nan, 0]]))


def test_only_a_source_that_is_there_can_be_moved():
    with pytest.raises(InputError, match=r"No source 1\. Allowed: 0 to 0\."):
        SourceSet([Dipole(1.0)]).move(1, np.eye(4))
    with pytest.raises(InputError, match=r"T_world_magnet is not a rigid pose"):
        SourceSet([Dipole(1.0)]).move(0, 2 * np.eye(4))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Dipole(0.0), "Dipole moment is 0.0. Allowed: above 0."),
        (lambda: Dipole(float("nan")), "Dipole moment is nan. Allowed: above 0."),
        (lambda: Cylinder(0.1, 0.0, 1.0), "Cylinder's length is 0.0. Allowed: above 0 to 1 m."),
        (lambda: Cylinder(0.1, 0.1, -1.0), "Cylinder's remanence is -1.0."),
        (lambda: Coil(0.1, 1.0, 0), "Coil turns is 0. Allowed: 1 or more."),
        (lambda: Coil(0.1, float("inf")), "Coil current is inf. Allowed: a finite number."),
        (lambda: Solenoid(0.1, 0.1, 1.0, 0), "Solenoid turns is 0. Allowed: 1 or more."),
        (lambda: Solenoid(0.1, 0.1, 1.0, 9, thickness=0.2), "0 to below twice the radius"),
        (lambda: Solenoid(0.1, 0.1, 1.0, 9, layers=0), "Solenoid layers is 0. Allowed: 1 to 100."),
        (lambda: UniformField(float("nan")), "UniformField flux_density is nan."),
        (lambda: Dipole(1.0, np.diag([1.0, 1, -1, 1])), "T_world_magnet is not a rigid pose."),
        (lambda: Dipole(1.0, np.eye(3)), "T_world_magnet is not a rigid pose. Allowed: 4 x 4"),
        (lambda: magnet_pose((0, 0, 0), (0, 0, 0)), "has no pose. Give finite numbers, no zero"),
    ],
)
def test_impossible_sources(make, message):
    with pytest.raises(InputError, match=re.escape(message)):
        make()
