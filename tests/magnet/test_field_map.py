"""Sampled fields: exact where the spline is, convergent elsewhere, read with stated units."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.scenes import random_poses
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.geometry import invert, rotate_vectors, transform_points
from vrcaps.magnet.field import field
from vrcaps.magnet.field_map import read_field_map
from vrcaps.magnet.sources import Cylinder, FieldMap

AXES = (np.linspace(-0.1, 0.2, 7), np.linspace(0.0, 0.3, 5), np.linspace(-0.2, 0.1, 9))


def grid(axes: tuple[np.ndarray, ...] = AXES) -> np.ndarray:
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)


def sampled(values: np.ndarray, axes: tuple[np.ndarray, ...] = AXES, **options: object) -> FieldMap:
    origin = tuple(axis[0] for axis in axes)
    spacing = tuple(axis[1] - axis[0] for axis in axes)
    return FieldMap(origin, spacing, values, **options)


def test_quadratic_fields_are_exact_also_at_the_edge():
    rng = np.random.default_rng(0)
    square, slope, rest = rng.normal(size=(3, 3, 3)), rng.normal(size=(3, 3)), rng.normal(size=3)

    def law(p: np.ndarray) -> np.ndarray:
        return np.einsum("kij,...i,...j->...k", square, p, p) + p @ slope.T + rest

    points = rng.uniform([-0.1, 0, -0.2], [0.2, 0.3, 0.1], (500, 3))
    points[:3] = [[-0.1, 0, -0.2], [0.2, 0.3, 0.1], [0.2, 0, 0.1]]
    flux, gradient = field([sampled(law(grid()))], points)
    np.testing.assert_allclose(flux, law(points), atol=1e-12)
    both = np.einsum("kij,...j->...ki", square + np.swapaxes(square, 1, 2), points)
    np.testing.assert_allclose(gradient, both + slope, atol=1e-11)


def test_gradient_is_that_of_the_spline():
    rng = np.random.default_rng(1)
    source = sampled(rng.normal(size=(*grid().shape[:3], 3)))
    points = rng.uniform([-0.09, 0.01, -0.19], [0.19, 0.29, 0.09], (200, 3))
    h = 1e-7
    columns = [
        (field([source], points + h * e)[0] - field([source], points - h * e)[0]) / (2 * h)
        for e in np.eye(3)
    ]
    np.testing.assert_allclose(field([source], points)[1], np.stack(columns, axis=-1), atol=1e-4)


def test_finer_maps_come_nearer_to_the_magnet():
    """Third order in the spacing for the field (Keys 1981): 8 times nearer when halved, or more."""
    rng = np.random.default_rng(2)
    magnet = Cylinder(0.1, 0.1, 1.4)
    points = rng.uniform(0.11, 0.19, (200, 3))
    exact = field([magnet], points)[0]
    errors = []
    for count in (9, 17, 33):
        axes = (np.linspace(0.1, 0.2, count),) * 3
        values = field([magnet], grid(axes).reshape(-1, 3))[0].reshape(count, count, count, 3)
        errors.append(np.abs(field([sampled(values, axes)], points)[0] - exact).max())
    assert errors[0] / errors[1] > 6
    assert errors[1] / errors[2] > 6
    assert errors[2] < 1e-4 * np.abs(exact).max()


def test_pose_and_factor():
    rng = np.random.default_rng(3)
    values = rng.normal(size=(*grid().shape[:3], 3))
    pose = random_poses(rng, 1)[0]
    points = rng.uniform([-0.1, 0, -0.2], [0.2, 0.3, 0.1], (50, 3))
    there = field(
        [sampled(values, factor=3.0, T_world_magnet=pose)], transform_points(pose, points)
    )
    here = field([sampled(values)], points)[0]
    np.testing.assert_allclose(there[0], 3 * rotate_vectors(pose, here), atol=1e-12)
    assert invert(pose).shape == (4, 4)


def test_outside_is_an_error():
    with pytest.raises(InputError, match=r"Point 1 at .* is outside a field map\. Give a map that"):
        field([sampled(np.zeros((*grid().shape[:3], 3)))], np.array([[0, 0.1, 0], [0, 0.1, 0.11]]))


@pytest.mark.parametrize("kind", ["npz", "csv"])
def test_files_read_in_their_units(tmp_path, kind):
    rng = np.random.default_rng(4)
    values = rng.normal(size=(*grid().shape[:3], 3))
    path = tmp_path / f"map.{kind}"
    if kind == "npz":
        x, y, z = (axis * 1e3 for axis in AXES)
        np.savez(path, x=x, y=y, z=z, flux_density=values * 1e3)
    else:
        rows = np.concatenate([values * 1e3, grid() * 1e3], axis=-1).reshape(-1, 6)
        rng.shuffle(rows)
        np.savetxt(path, rows, delimiter=",", header="bx,by,bz,x,y,z", comments="")
    read = read_field_map(path, length_unit="mm", flux_unit="mT")
    np.testing.assert_allclose(read.origin, [-0.1, 0.0, -0.2], atol=1e-15)
    np.testing.assert_allclose(read.spacing, [0.05, 0.075, 0.0375])
    np.testing.assert_allclose(read.flux_density, values)


def arrays(**changes: np.ndarray) -> dict[str, np.ndarray]:
    x, y, z = AXES
    flux = np.zeros((len(x), len(y), len(z), 3))
    return {"x": x, "y": y, "z": z, "flux_density": flux} | changes


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (arrays(x=AXES[0] ** 3), r"axis x is not evenly spaced and ascending"),
        (arrays(x=AXES[0][::-1]), r"axis x is not evenly spaced and ascending"),
        (arrays(z=AXES[2][:8]), r"flux_density has shape \(7, 5, 9, 3\)\. Allowed: \(7, 5, 8, 3\)"),
        (arrays(x=AXES[0][:3], flux_density=np.zeros((3, 5, 9, 3))), r"axis x has shape \(3,\)"),
        ({"x": AXES[0]}, r"Allowed: arrays x, y, z and flux_density"),
    ],
)
def test_npz_that_is_no_map(tmp_path, given, message):
    np.savez(tmp_path / "map.npz", **given)
    with pytest.raises(InputError, match=message):
        read_field_map(tmp_path / "map.npz", length_unit="m", flux_unit="T")


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("map.csv", "x,y,z,bx,by\n", r"columns .* Allowed: x, y, z, bx, by, bz"),
        ("map.csv", "x,y,z,bx,by,bz\n", "no rows of six numbers"),
        ("map.csv", "x,y,z,bx,by,bz\n0,0,0,1,2,a\n", "could not convert .* numbers, six to a row"),
        (
            "map.csv",
            "x,y,z,bx,by,bz\n0,0,0,1,2,3\n1,1,0,1,2,3\n",
            "do not fill a grid of 2 x 2 x 1",
        ),
        ("map.npz", "nonsense", "is not an NPZ file of numbers"),
        ("map.txt", "", r"unknown kind of field map\. Allowed: \.npz, \.csv"),
    ],
)
def test_files_that_are_no_map(tmp_path, name, text, message):
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=message):
        read_field_map(tmp_path / name, length_unit="m", flux_unit="T")


def test_units_and_files_must_be_known(tmp_path):
    with pytest.raises(
        UnknownNameError, match=r"No unit of flux density named 'Gs'\. Known: G, T, mT"
    ):
        read_field_map(tmp_path / "map.csv", length_unit="m", flux_unit="Gs")
    with pytest.raises(InputError, match=r"Cannot read the field map .*: No such file"):
        read_field_map(tmp_path / "map.csv", length_unit="m", flux_unit="G")


@pytest.mark.parametrize(
    ("origin", "spacing", "values", "message"),
    [
        (
            (0, 0, 0),
            (1, 1, 1),
            np.zeros((4, 4, 3, 3)),
            r"shape \(4, 4, 3, 3\)\. Allowed: \[nx ny nz 3\]",
        ),
        ((0, 0, 0), (1, 1, 1), np.full((4, 4, 4, 3), np.nan), "values that are not finite"),
        ((0, 0, 0), (1, 0, 1), np.zeros((4, 4, 4, 3)), "Allowed: finite numbers, spacing above 0"),
    ],
)
def test_impossible_maps(origin, spacing, values, message):
    with pytest.raises(InputError, match=message):
        FieldMap(origin, spacing, values)
