"""Surface of a lumen fraction, and segments along the centerline of a colon."""

import sys
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from vrcaps.anatomy.colon import generate_colon
from vrcaps.anatomy.colon.parameters import SEGMENTS
from vrcaps.anatomy.full_tract.patient import draw_patient_anatomy
from vrcaps.core.errors import InputError, MissingExtraError
from vrcaps.mesh.mesh import Mesh
from vrcaps.organ.surface import OrganSurface
from vrcaps.tools.ct.fraction import LumenFraction, bounding_box, number_parts
from vrcaps.tools.ct.surface import (
    colon_borders,
    colon_labels,
    decimate,
    extract_wall,
    runs_upwards,
    smooth,
)


@pytest.fixture(scope="module")
def organ() -> OrganSurface:
    """The colon of patient 0 with large triangles, without its mucosa."""
    return generate_colon(replace(draw_patient_anatomy(0).colon, triangles=20_000), seed=0)


@pytest.mark.slow
def test_a_generated_colon_is_divided_much_as_it_was_made(organ: OrganSurface) -> None:
    """Borders within 5 % of the length; flexures, which have landmarks, within 3 %.

    This colon's transverse part rises as high as its hepatic flexure.
    """
    length = organ.centerline.length
    true = [organ.arc_length[organ.label == n + 1].max() for n in range(len(SEGMENTS) - 1)]
    away = np.abs(colon_borders(organ.centerline) - true) / length
    assert away.max() < 0.05
    assert away[1:5].max() < 0.03
    label, names = colon_labels(organ.centerline, organ.arc_length)
    assert names == ("background", *SEGMENTS)
    assert set(label) == set(range(1, 9))
    assert np.mean(label == organ.label) > 0.9


@pytest.mark.slow
def test_the_rectum_is_the_lower_end(organ: OrganSurface) -> None:
    centerline = organ.centerline
    assert not runs_upwards(centerline)
    assert runs_upwards(replace(centerline, points=centerline.points[::-1]))


def ball(radius: float, spacing=(1e-3, 0.7e-3, 0.7e-3), *, binary: bool = False) -> LumenFraction:
    """A ball about the origin; the share of a voxel is linear over a voxel's width."""
    size = (np.ceil(radius / np.array(spacing)) + 4).astype(int)
    transform = np.eye(4)
    transform[:3, :3] = np.eye(3)[:, ::-1] * spacing
    transform[:3, 3] = -(transform[:3, :3] @ size)
    grid = np.stack(np.meshgrid(*(np.arange(2 * n + 1) for n in size), indexing="ij"), axis=-1)
    away = np.linalg.norm(grid @ transform[:3, :3].T + transform[:3, 3], axis=-1)
    share = np.clip(0.5 + (radius - away) / np.mean(spacing), 0.0, 1.0)
    return LumenFraction((share > 0.5 if binary else share).astype(np.float32), transform)


@pytest.mark.parametrize("radius", [0.003, 0.01])
def test_a_ball_comes_back_from_partial_volume(radius) -> None:
    """On the mean to 7 % of a voxel, everywhere to 40 %."""
    mesh = extract_wall(ball(radius), blur=0.5, pass_band=0.1, edge=0.8e-3)
    error = np.linalg.norm(mesh.vertices, axis=1) - radius
    assert np.abs(error).max() < 0.35e-3
    assert abs(error.mean()) < 0.06e-3


@pytest.mark.parametrize("spacing", [(1e-3, 0.7e-3, 0.7e-3), (3e-3, 3e-3, 3e-3)])
def test_a_mask_comes_back_without_steps(spacing) -> None:
    """Volume within 2 %; no vertex farther off than about half a voxel."""
    radius = 8.3 * max(spacing)
    lumen = ball(radius, spacing, binary=True)
    mesh = extract_wall(lumen, blur=0.7, pass_band=0.1, edge=1e-3)
    judge = trimesh.Trimesh(mesh.vertices, mesh.faces)
    voxels = lumen.fraction.sum() * lumen.voxel_volume
    assert abs(judge.volume) == pytest.approx(voxels, rel=0.02)
    assert np.abs(np.linalg.norm(mesh.vertices, axis=1) - radius).max() < 0.52 * max(spacing)


def test_smoothing_keeps_size_and_removes_noise() -> None:
    judge = trimesh.creation.icosphere(subdivisions=5, radius=0.01)
    noisy = np.array(judge.vertices)
    noisy += 1e-4 * np.random.default_rng(0).standard_normal(noisy.shape)
    smoothed = smooth(noisy, judge.faces, 0.1)
    before = np.linalg.norm(noisy, axis=1) - 0.01
    after = np.linalg.norm(smoothed, axis=1) - 0.01
    assert after.std() < 0.3 * before.std()
    assert abs(after.mean()) < 1e-5
    assert np.array_equal(smooth(noisy, judge.faces, 2.0), noisy)


def test_smoothing_leaves_borders() -> None:
    sheet = trimesh.creation.icosphere(subdivisions=3)
    faces = sheet.faces[(sheet.vertices[sheet.faces][..., 2] > 0).all(axis=1)]
    border = trimesh.Trimesh(sheet.vertices, faces, process=False).outline().referenced_vertices
    smoothed = smooth(np.array(sheet.vertices), faces, 0.05)
    assert np.array_equal(smoothed[border], sheet.vertices[border])


def test_a_lumen_cut_by_the_scan_stays_open_there() -> None:
    lumen = ball(0.01)
    half = lumen.crop((slice(0, lumen.fraction.shape[0] // 2), slice(None), slice(None)))
    mesh = extract_wall(half, blur=0.5, pass_band=0.1, edge=0.8e-3)
    outline = trimesh.Trimesh(mesh.vertices, mesh.faces).outline()
    border = outline.vertices[outline.referenced_vertices]
    assert np.ptp(border[:, 2]) < 1e-4
    assert len(border) > 20


def test_edge_length_is_as_stated() -> None:
    fine = extract_wall(ball(0.015), blur=0.5, pass_band=0.1, edge=0.3e-3)
    mesh = decimate(fine, 2e-3)
    ends = mesh.vertices[mesh.faces]
    length = np.linalg.norm(np.roll(ends, -1, axis=1) - ends, axis=2).mean()
    assert length == pytest.approx(2e-3, rel=0.15)
    assert decimate(mesh, 1e-3) is mesh


def test_without_the_decimator_the_extra_is_named(monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "fast_simplification", None)
    judge = trimesh.creation.icosphere()
    with pytest.raises(MissingExtraError, match="fast-simplification is not installed"):
        decimate(Mesh(np.array(judge.vertices), np.array(judge.faces)), 0.5)


def test_a_lumen_of_less_than_a_voxel() -> None:
    share = np.zeros((7, 7, 7), np.float32)
    share[3, 3, 3] = 1.0
    with pytest.raises(InputError, match="too small for the scan's voxels"):
        extract_wall(
            LumenFraction(share, np.diag([1e-3, 1e-3, 1e-3, 1.0])),
            blur=1.0,
            pass_band=0.1,
            edge=1e-3,
        )


def test_parts_are_numbered_by_size_without_strays() -> None:
    share = np.zeros((20, 10, 10), np.float32)
    share[1:4, 1:4, 1:4] = 1.0
    share[8:18, 1:9, 1:9] = 1.0
    share[6, 6, 6] = 1.0
    part, volumes = number_parts(LumenFraction(share, np.eye(4)), 2.0)
    assert volumes == [640.0, 27.0]
    assert part[10, 5, 5] == 1
    assert part[2, 2, 2] == 2
    assert part[6, 6, 6] == 0
    assert bounding_box(part == 1) == (slice(8, 18), slice(1, 9), slice(1, 9))
