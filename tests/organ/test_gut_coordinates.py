"""Gut coordinates on tubes whose coordinates are known in closed form."""

import numpy as np
import pytest

from vrcaps.core.units import MM
from vrcaps.organ.centerline import centerline_from_points
from vrcaps.organ.gut_coordinates import gut_coordinates

RADIUS = 10 * MM


def sweep(points, frames, radius, num_around=48):
    """Tube about a curve, faces counter-clockwise seen from inside; its true angle and sample."""
    n = len(points)
    angle = np.linspace(-np.pi, np.pi, num_around, endpoint=False) + 0.03
    ring = (
        np.cos(angle)[:, None] * frames[:, None, :, 0]
        + np.sin(angle)[:, None] * frames[:, None, :, 1]
    )
    vertices = points[:, None] + radius * ring
    i, j = np.meshgrid(np.arange(n - 1), np.arange(num_around), indexing="ij")
    a, b = i * num_around + j, i * num_around + (j + 1) % num_around
    c, d = a + num_around, b + num_around
    faces = np.concatenate([np.stack([a, c, b], -1), np.stack([b, c, d], -1)]).reshape(-1, 3)
    return vertices.reshape(-1, 3), faces, np.tile(angle, n), np.repeat(np.arange(n), num_around)


def tube_about(curve, num_samples=120):
    """Centerline, tube and true coordinates of a curve given by a function of [0, 1]."""
    points = curve(np.linspace(0.0, 1.0, num_samples))
    # A first tube with any frames gives the frames of the centerline itself.
    far = np.array([[1e3, 0, 0], [1e3, 1, 0], [1e3, 0, 1.0]])
    line = centerline_from_points(points, far, np.array([[0, 1, 2]]), step=RADIUS / 16)
    pick = np.arange(0, len(line.points), 8)
    vertices, faces, theta, ring = sweep(line.points[pick], line.frames[pick], RADIUS)
    return (line.points, vertices, faces, theta, line.arc_length[pick][ring])


CURVES = {
    "straight": lambda t: np.stack([0 * t, 0.3 * t, 0.1 * t], -1),
    "torus": lambda t: 25 * MM * np.stack([np.cos(4 * t), np.sin(4 * t), 0 * t], -1),
    # Turns 22 mm apart: 2 mm of tissue between neighboring loops.
    "helix": lambda t: np.stack(
        [30 * MM * np.cos(18 * t), 30 * MM * np.sin(18 * t), 18 * t * 22 * MM / (2 * np.pi)], -1
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("curve", CURVES.values(), ids=CURVES)
def test_tube(curve):
    points, vertices, faces, theta, arc_length = tube_about(curve)
    line = centerline_from_points(points, vertices, faces)
    found_s, found_theta, found_r = gut_coordinates(vertices, faces, line)
    assert np.abs(found_s - arc_length).max() < 0.02 * RADIUS
    turn = np.angle(np.exp(1j * (found_theta - theta)))
    assert np.abs(turn).max() < 5e-3
    np.testing.assert_allclose(found_r, RADIUS, rtol=1e-3)
    assert found_theta.min() > -np.pi
    assert found_theta.max() <= np.pi


@pytest.mark.slow
def test_nearer_axis_of_a_neighboring_loop_is_not_taken():
    """Pouches of one turn reach closer to the next turn's axis than to their own."""

    def curve(t):
        return np.stack([40 * MM * np.cos(12 * t), 40 * MM * np.sin(12 * t), 12 * t * 4 * MM], -1)

    points, vertices, faces, _, arc_length = tube_about(curve)
    line = centerline_from_points(points, vertices, faces)
    foot = np.stack([np.interp(arc_length, line.arc_length, p) for p in line.points.T], -1)
    # Narrow where turns meet (25 mm apart), but for the upper side, which bulges.
    upper = vertices[:, 2:] > foot[:, 2:]
    wall = foot + (vertices - foot) * np.where(upper, [0.6, 0.6, 1.6], [0.6, 0.6, 0.6])
    line = centerline_from_points(points, wall, faces)
    distance = np.linalg.norm(wall[:, None] - line.points[None, ::8], axis=2)
    nearest = line.arc_length[::8][np.argmin(distance, axis=1)]
    assert np.abs(nearest - arc_length).max() > 0.2
    found, _, _ = gut_coordinates(wall, faces, line)
    assert np.abs(found - arc_length).max() < 0.5 * RADIUS


def test_theta_turns_from_first_to_second_axis():
    points, vertices, faces, _, _ = tube_about(CURVES["straight"])
    line = centerline_from_points(points, vertices, faces)
    probe = np.concatenate([vertices, line.points[50:51] + RADIUS * line.frames[50, :, 1]])
    _, theta, _ = gut_coordinates(probe, faces, line)
    assert theta[-1] == pytest.approx(np.pi / 2, abs=1e-6)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param("colon_GI1_mm", marks=pytest.mark.validation),
        pytest.param("stomach_A_mm", marks=pytest.mark.validation),
        "stomach_C_mm",
    ],
)
def test_real_organ_is_continuous(real_organ, name):
    mesh = real_organ(name)
    line, arc_length, theta, radius = mesh.centerline, mesh.arc_length, mesh.theta, mesh.radius
    assert arc_length.min() >= 0.0
    assert arc_length.max() <= line.length
    assert np.isfinite(theta).all()
    edges = mesh.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    step = np.abs(np.diff(arc_length[edges], axis=1)[:, 0])
    length = np.linalg.norm(np.diff(mesh.vertices[edges], axis=1)[:, 0], axis=1)
    assert np.percentile(step / length, 99.9) < 4.0
    assert (step / length).max() < 8.0
    assert radius.min() > 0.9 * line.radius.min()
