"""The default mucosa: reproducible, seamless, padded, plausible."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from vrcaps.errors import InputError, UnknownNameError
from vrcaps.organ.appearance import MAX_SIDE, MUCOSAE, Mucosa, bake_appearance
from vrcaps.organ.surface import Appearance, Centerline, OrganSurface, vertex_normals
from vrcaps.units import MM

RADIUS, LENGTH, COLUMNS, ROWS = 12.0 * MM, 60.0 * MM, 40, 32


def make_tube(shift: float = 0.0) -> OrganSurface:
    """A straight tube, seen from inside; u around it from `shift`, v along it."""
    angle = np.arange(COLUMNS) * (2.0 * np.pi / COLUMNS)
    along = np.linspace(0.0, LENGTH, ROWS + 1)
    grid_s, grid_angle = np.meshgrid(along, angle, indexing="ij")
    vertices = np.stack(
        [RADIUS * np.cos(grid_angle), RADIUS * np.sin(grid_angle), grid_s], axis=-1
    ).reshape(-1, 3)
    row, column = (part.ravel() for part in np.mgrid[:ROWS, :COLUMNS])
    nodes = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])  # around a quad: row, column
    rows, columns = row[:, None] + nodes[:, 0], column[:, None] + nodes[:, 1]
    quads = rows * COLUMNS + columns % COLUMNS
    quad_uv = np.stack([columns / COLUMNS + shift, 0.05 + 0.9 * rows / ROWS], axis=-1)
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    uv = np.concatenate([quad_uv[:, [0, 1, 2]], quad_uv[:, [0, 2, 3]]])
    count = len(vertices)
    frames = np.tile(np.eye(3), (len(along), 1, 1))
    axis = np.stack([0.0 * along, 0.0 * along, along], axis=-1)
    return OrganSurface(
        name="tube",
        vertices=vertices,
        faces=faces,
        normals=vertex_normals(vertices, faces),
        uv=uv,
        label=np.ones(count, np.uint8),
        label_names=("background", "wall"),
        instance=np.zeros(count, np.uint16),
        arc_length=grid_s.ravel(),
        theta=grid_angle.ravel() - np.pi,
        radius=np.full(count, RADIUS),
        centerline=Centerline(axis, along, np.full(len(along), RADIUS), frames),
    )


def in_charts(organ: OrganSurface, num_strips: int) -> OrganSurface:
    """The organ with its strips of rows laid side by side, with gaps, as separate charts."""
    strip = np.clip((organ.uv[..., 1].mean(axis=1) - 0.05) / 0.9, 0.0, 0.999) * num_strips
    strip = np.floor(strip)[:, None]
    u = (0.9 * organ.uv[..., 0] + 0.05 + strip) / num_strips
    v = 0.05 + 0.9 * ((organ.uv[..., 1] - 0.05) / 0.9 * num_strips - strip)
    return replace(organ, uv=np.stack([u, v], axis=-1))


def decode(code: np.ndarray) -> np.ndarray:
    """Linear light from sRGB (IEC 61966-2-1)."""
    code = code / 255.0
    return np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)


def sample(texture: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Bilinear lookup with wrap-around; row 0 is v = 1."""
    height, width = texture.shape[:2]
    x, y = uv[..., 0] * width - 0.5, (1.0 - uv[..., 1]) * height - 0.5
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    total = 0.0
    for dx in (0, 1):
        for dy in (0, 1):
            weight = np.abs(1 - dx - (x - left)) * np.abs(1 - dy - (y - top))
            texel = texture[(top + dy) % height, (left + dx) % width]
            total = total + weight.reshape(weight.shape + (1,) * (texel.ndim - weight.ndim)) * texel
    return total


def digest(appearance: Appearance) -> str:
    parts = (appearance.albedo, appearance.roughness, appearance.height)
    return hashlib.sha256(b"".join(part.tobytes() for part in parts)).hexdigest()


@pytest.fixture(scope="module")
def tube() -> OrganSurface:
    return make_tube()


@pytest.fixture(scope="module")
def baked(tube: OrganSurface) -> Appearance:
    return bake_appearance(tube, seed=4)


def test_the_same_seed_gives_the_same_bytes_on_any_number_of_threads(tube):
    script = (
        f"import importlib.util as i; s = i.spec_from_file_location('t', r'{__file__}');"
        "t = i.module_from_spec(s); s.loader.exec_module(t);"
        "print(t.digest(t.bake_appearance(t.make_tube(), seed=4, texels_per_mm=4.0)))"
    )
    here = digest(bake_appearance(tube, seed=4, texels_per_mm=4.0))
    for threads in ("1", "2"):
        environment = {**os.environ, "RAYON_NUM_THREADS": threads}
        run = subprocess.run(
            [sys.executable, "-c", script],
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        )
        assert run.stdout.strip() == here


def test_another_seed_is_another_patient(tube):
    one, other = (bake_appearance(tube, seed=seed, texels_per_mm=2.0) for seed in (1, 2))
    difference = np.abs(one.albedo.astype(int) - other.albedo)
    assert (difference.max(axis=-1) > 2).mean() > 0.5


@pytest.mark.parametrize("name", MUCOSAE)
def test_every_mucosa_is_finite_and_plausible(tube, name):
    appearance = bake_appearance(tube, seed=3, mucosa=name, texels_per_mm=4.0)
    mean = decode(appearance.albedo).mean(axis=(0, 1))
    # Mucosa is red: endoscopic images in linear light have 0.53 to 0.86 red and 0.03 to 0.18 blue.
    red, green, blue = mean / mean.sum()
    assert 0.53 < red < 0.86
    assert 0.03 < blue < 0.18
    assert red > green > blue
    assert 0.15 < mean.mean() < 0.5
    assert np.isfinite(appearance.height).all()
    assert 0.02 * MM < appearance.height.std() < 0.3 * MM
    assert appearance.roughness.std() > 1.0


def test_the_size_follows_the_wall_and_the_density(baked):
    height, width = baked.albedo.shape[:2]
    assert width / (2.0 * np.pi * RADIUS / MM) == pytest.approx(8.0, rel=0.05)
    assert 0.9 * height / (LENGTH / MM) == pytest.approx(8.0, rel=0.05)
    assert baked.roughness.shape == baked.height.shape == (height, width)


def test_a_texture_keeps_to_its_limits(tube):
    small = bake_appearance(tube, seed=0, max_texels=40_000)
    height, width = small.roughness.shape
    assert 20_000 < height * width <= 40_000
    long = replace(tube, vertices=tube.vertices * np.array([1.0, 1.0, 40.0]))
    assert max(bake_appearance(long, seed=0, max_texels=400_000).height.shape) <= MAX_SIDE


def test_colour_does_not_depend_on_where_the_texture_begins(tube, baked):
    """The wall's colour at a point is the same when u starts elsewhere, across the wrap too."""
    shift = 0.37
    moved = bake_appearance(make_tube(shift), seed=4)
    columns = baked.albedo.shape[1]
    middle = tube.uv.mean(axis=1)
    difference = decode(sample(moved.albedo, middle + np.array([shift, 0.0])))
    difference -= decode(sample(baked.albedo, middle))
    assert columns == moved.albedo.shape[1]
    assert np.sqrt((difference**2).mean()) < 0.01


def test_no_seam_between_charts(tube, baked):
    """Where two charts meet, the same point of the wall has the same colour in both."""
    organ = in_charts(tube, 4)
    appearance = bake_appearance(organ, seed=4)
    edges = np.sort(np.stack([tube.faces, np.roll(tube.faces, -1, axis=1)], axis=-1), axis=-1)
    key = edges[..., 0] * len(tube.vertices) + edges[..., 1]
    order = np.argsort(key.ravel(), kind="stable")
    pairs = (
        order[:-1][np.diff(key.ravel()[order]) == 0],
        order[1:][np.diff(key.ravel()[order]) == 0],
    )
    ends = np.stack([organ.uv, np.roll(organ.uv, -1, axis=1)], axis=2).reshape(-1, 2, 2)
    near, far = ends[pairs[0]], ends[pairs[1]][:, ::-1]  # shared edges run opposite ways
    is_border = np.abs(near - far).max(axis=(1, 2)) > 0.02
    assert is_border.sum() >= 3 * COLUMNS
    weights = np.linspace(0.0, 1.0, 9)[:, None, None]
    for name, tolerance in (("albedo", 1.5), ("height", 1e-6)):
        texture = getattr(appearance, name).astype(float)
        one, other = (
            sample(texture, e[is_border, 0] * (1 - weights) + e[is_border, 1] * weights)
            for e in (near, far)
        )
        assert np.sqrt(((one - other) ** 2).mean()) < tolerance < 0.05 * texture.std()


def test_charts_are_padded(tube):
    """Texels within four of a chart are no background: they continue it."""
    organ = in_charts(tube, 4)
    appearance = bake_appearance(organ, seed=4, texels_per_mm=4.0)
    height, width = appearance.height.shape
    background = np.ones((height, width), bool)
    x, y = np.meshgrid((np.arange(width) + 0.5) / width, 1.0 - (np.arange(height) + 0.5) / height)
    for strip in range(4):
        left, right = (0.05 + strip) / 4, (0.95 + strip) / 4
        near_u = (x > left - 4.0 / width) & (x < right + 4.0 / width)
        background &= ~(near_u & (y > 0.05 - 4.0 / height) & (y < 0.95 + 4.0 / height))
    assert 0.0 < background.mean() < 0.5
    assert (appearance.height[~background] != 0.0).mean() > 0.999


def test_vessels_darken_green_more_than_red(tube, baked):
    bare = bake_appearance(tube, seed=4, mucosa=replace(MUCOSAE["colon"], vessel_contrast=0.0))
    kept = decode(baked.albedo) / decode(bare.albedo)
    vessel = kept[..., 1] < 0.8
    assert 0.02 < vessel.mean() < 0.5
    assert (kept[vessel, 0] > kept[vessel, 1]).mean() > 0.99
    assert np.median(kept[~vessel, 1]) > 0.9


def test_relief_scales_with_its_slope(tube):
    plain = replace(MUCOSAE["colon"], vessel_contrast=0.0, pit_slope=0.0)
    heights = [
        bake_appearance(tube, seed=1, mucosa=replace(plain, relief_slope=slope), texels_per_mm=4.0)
        for slope in (0.05, 0.10)
    ]
    np.testing.assert_allclose(heights[1].height, 2.0 * heights[0].height, atol=1e-9)


def test_relief_has_the_slope_it_is_given(tube):
    """RMS slope over texels near 0.7·1 ⊕ 1 ⊕ 0.3 shares, up to the texels' band limit."""
    mucosa = replace(
        MUCOSAE["colon"],
        vessel_contrast=0.0,
        pit_slope=0.0,
        relief_slope=0.1,
        base_color=(0.5,) * 3,
    )
    appearance = bake_appearance(tube, seed=1, mucosa=mucosa)
    height, width = appearance.height.shape
    rows = slice(height // 10, -height // 10)
    along = np.diff(appearance.height[rows], axis=0) / (LENGTH / 0.9 / height)
    around = np.diff(appearance.height[rows], axis=1) / (2.0 * np.pi * RADIUS / width)
    slope = np.sqrt((along**2).mean() + (around**2).mean())
    assert slope == pytest.approx(0.1 * np.hypot(np.hypot(0.7, 1.0), 0.3), rel=0.25)


def test_errors_say_what_is_wrong(tube):
    with pytest.raises(UnknownNameError, match=r"No mucosa named 'colom'\. Known: colon"):
        bake_appearance(tube, seed=0, mucosa="colom")
    with pytest.raises(InputError, match="one pair for each corner"):
        bake_appearance(replace(tube, uv=tube.uv[:5]), seed=0)
    with pytest.raises(InputError, match="finite"):
        bake_appearance(replace(tube, uv=np.full_like(tube.uv, np.nan)), seed=0)
    with pytest.raises(InputError, match="give no area to most"):
        bake_appearance(replace(tube, uv=np.zeros_like(tube.uv)), seed=0)
    with pytest.raises(InputError, match="more than once"):
        bake_appearance(replace(tube, uv=tube.uv * 2.0), seed=0)
    with pytest.raises(InputError, match="texels_per_mm is -1"):
        bake_appearance(tube, seed=0, texels_per_mm=-1.0)
    with pytest.raises(InputError, match="max_texels is 3"):
        bake_appearance(tube, seed=0, max_texels=3)
    with pytest.raises(InputError, match=r"need a texture of .* Lower texels_per_mm"):
        bake_appearance(tube, seed=0, texels_per_mm=400.0)


def test_a_users_own_mucosa(tube):
    pale = bake_appearance(
        tube, seed=0, mucosa=Mucosa(base_color=(0.8, 0.75, 0.7), bile=0.0), texels_per_mm=2.0
    )
    assert decode(pale.albedo).mean() > 0.5
    assert pale.coat_gloss == Mucosa(base_color=(0, 0, 0)).coat_gloss
