"""The default mucosa: reproducible, seamless, padded, plausible."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.programs import run_program
from tests.support.tubes import straight_tube
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.units import MM
from vrcaps.mucosa.bake import MAX_SIDE, bake_appearance
from vrcaps.mucosa.mucosa import MUCOSAE, Mucosa, MucosaSettings, own_mucosa
from vrcaps.organ.surface import HEIGHT_STEP, Appearance, Centerline, OrganSurface
from vrcaps.organ.uv import texture_stretch

RADIUS, LENGTH, COLUMNS, ROWS = 12.0 * MM, 60.0 * MM, 40, 32


def make_tube(shift: float = 0.0) -> OrganSurface:
    """A straight tube, seen from inside; u around it from `shift`, v along it."""
    plain = straight_tube(LENGTH, RADIUS, COLUMNS, ROWS + 1)
    return replace(plain, uv=plain.uv * (1.0, 0.9) + (shift, 0.05))


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


def make_square(side: float, label_names: tuple[str, ...] = ("background", "wall")):
    """A flat square of two faces in the middle of its texture; z is up, into the lumen."""
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    vertices = np.column_stack([corners * side, np.zeros(4)])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    line = np.array([[0.0, 0.0, side], [side, 0.0, side]])
    return OrganSurface(
        name="square",
        vertices=vertices,
        faces=faces,
        normals=np.tile([0.0, 0.0, 1.0], (4, 1)),
        uv=0.2 + 0.6 * corners[faces],
        label=np.ones(4, np.uint8),
        label_names=label_names,
        instance=np.zeros(4, np.uint16),
        arc_length=vertices[:, 0],
        theta=np.zeros(4),
        radius=np.full(4, side),
        centerline=Centerline(line, line[:, 0], np.full(2, side), np.tile(np.eye(3), (2, 1, 1))),
    )


def mix(h: np.ndarray) -> np.ndarray:
    """The core's bit mixer, on uint32."""
    h = h ^ (h >> 16)
    h = h * np.uint32(0x7FEB352D)
    h = h ^ (h >> 15)
    h = h * np.uint32(0x846CA68B)
    return h ^ (h >> 16)


def triple(seed: int, cell: np.ndarray) -> np.ndarray:
    """Three numbers in [−1, 1] of each lattice point."""
    x, y, z = np.moveaxis(cell.astype(np.int32).view(np.uint32), -1, 0)
    primes = [np.uint32(prime) for prime in (0x8DA6B343, 0xD8163841, 0xCB1AB31F)]
    h = mix(np.uint32(seed) ^ (x * primes[0]) ^ (y * primes[1]) ^ (z * primes[2]))
    return np.stack([(h >> shift) & 1023 for shift in (0, 10, 20)], axis=-1) * (2.0 / 1023.0) - 1.0


def displacement(seed: int, size: float, p: np.ndarray) -> np.ndarray:
    """Smooth random vectors over a lattice."""
    cell = np.floor(p / size).astype(int)
    t = p / size - cell
    fade = t**3 * (t * (t * 6.0 - 15.0) + 10.0)
    total = np.zeros_like(p)
    for corner in np.ndindex(2, 2, 2):
        weight = np.where(np.array(corner) == 1, fade, 1.0 - fade).prod(axis=-1)
        total += weight[..., None] * triple(seed, cell + np.array(corner))
    return total


def gradient_noise(seed: int, size: float, p: np.ndarray) -> np.ndarray:
    """Gradient noise of zero mean and standard deviation 0.76."""
    cell = np.floor(p / size).astype(int)
    t = p / size - cell
    fade = t**3 * (t * (t * 6.0 - 15.0) + 10.0)
    total = np.zeros(len(p))
    for corner in np.ndindex(2, 2, 2):
        weight = np.where(np.array(corner) == 1, fade, 1.0 - fade).prod(axis=-1)
        total += weight * (triple(seed, cell + np.array(corner)) * (t - corner)).sum(axis=-1)
    return 3.98 * total


def cell_border(seed: int, size: float, p: np.ndarray) -> np.ndarray:
    """Distance to the second nearest point of a jittered lattice less that to the nearest."""
    cell = np.floor(p / size).astype(int)
    near = np.array(list(np.ndindex(3, 3, 3))) - 1
    points = [cell + step + 0.5 + 0.4 * triple(seed, cell + step) for step in near]
    distance = np.sort([np.linalg.norm(point - p / size, axis=-1) for point in points], axis=0)
    return distance[1] - distance[0]


@pytest.fixture(scope="module")
def tube() -> OrganSurface:
    return make_tube()


@pytest.fixture(scope="module")
def baked(tube: OrganSurface) -> Appearance:
    return bake_appearance(tube, seed=4)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_bytes_on_any_number_of_threads(tube):
    script = (
        f"import sys; sys.path.append(r'{Path(__file__).parents[1]}');"
        f"import importlib.util as i; s = i.spec_from_file_location('t', r'{__file__}');"
        "t = i.module_from_spec(s); s.loader.exec_module(t);"
        "print(t.digest(t.bake_appearance(t.make_tube(), seed=4, texels_per_mm=4.0)))"
    )
    here = digest(bake_appearance(tube, seed=4, texels_per_mm=4.0))
    for threads in ("1", "2"):
        run = run_program(script, environment={"RAYON_NUM_THREADS": threads})
        assert run.stdout.strip() == here


def test_another_seed_is_another_patient(tube):
    one, other = (bake_appearance(tube, seed=seed, texels_per_mm=2.0) for seed in (1, 2))
    difference = np.abs(one.albedo.astype(int) - other.albedo)
    assert (difference.max(axis=-1) > 2).mean() > 0.5


@pytest.mark.parametrize("name", MUCOSAE)
def test_every_mucosa_is_finite_and_plausible(tube, name):
    appearance = bake_appearance(tube, seed=3, mucosa=name, texels_per_mm=4.0)
    mean = decode(appearance.albedo).mean(axis=(0, 1))
    # Mucosa is red: in linear light, images of colonoscopes have 0.53 to 0.86 red and 0.03 to 0.18
    # blue, capsule frames of the small bowel (WCEBleedGen, 1 to 99 %) 0.49 to 0.75, 0.04 to 0.19.
    red, green, blue = mean / mean.sum()
    assert (0.49 if name == "small-bowel" else 0.53) < red < 0.86
    assert 0.03 < blue < 0.18
    assert red > green > blue
    assert 0.15 < mean.mean() < 0.5
    assert np.isfinite(appearance.height).all()
    assert 0.02 * MM < appearance.height.std() < 0.3 * MM
    assert appearance.roughness.std() > 1.0


@pytest.mark.slow
def test_the_size_follows_the_wall_and_the_density(baked):
    height, width = baked.albedo.shape[:2]
    assert width / (2.0 * np.pi * RADIUS / MM) == pytest.approx(8.0, rel=0.05)
    assert 0.9 * height / (LENGTH / MM) == pytest.approx(8.0, rel=0.05)


@pytest.mark.slow
def test_squeezed_faces_get_the_density_too(tube):
    """If u is crowded on a tenth of the wall, the whole texture gets more texels."""
    u = tube.uv[..., 0]
    crowded = np.where(u < 0.9, u * 0.93 / 0.9, 0.93 + (u - 0.9) * 0.7)
    organ = replace(tube, uv=np.stack([crowded, tube.uv[..., 1]], axis=-1))
    height, width = bake_appearance(organ, seed=0).height.shape
    stretch = texture_stretch(organ.vertices[organ.faces], organ.uv * [width, height]) * MM
    assert np.percentile(np.abs(stretch[:, 0]), 5.5) >= 8.0


def test_all_textures_have_one_size(baked):
    height, width = baked.albedo.shape[:2]
    assert baked.roughness.shape == baked.height.shape == (height, width)


@pytest.mark.slow
def test_a_texture_keeps_to_its_limits(tube):
    small = bake_appearance(tube, seed=0, max_texels=40_000)
    height, width = small.roughness.shape
    assert 20_000 < height * width <= 40_000
    long = replace(tube, vertices=tube.vertices * np.array([1.0, 1.0, 40.0]))
    assert max(bake_appearance(long, seed=0, max_texels=400_000).height.shape) <= MAX_SIDE


@pytest.mark.slow
def test_color_does_not_depend_on_where_the_texture_begins(tube, baked):
    """The wall's color at a point is the same when u starts elsewhere, across the wrap too."""
    shift = 0.37
    moved = bake_appearance(make_tube(shift), seed=4)
    columns = baked.albedo.shape[1]
    middle = tube.uv.mean(axis=1)
    difference = decode(sample(moved.albedo, middle + np.array([shift, 0.0])))
    difference -= decode(sample(baked.albedo, middle))
    assert columns == moved.albedo.shape[1]
    assert np.sqrt((difference**2).mean()) < 0.01


@pytest.mark.slow
def test_no_seam_between_charts(tube, baked):
    """At the seam of two charts, the same point of the wall has the same color in both."""
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


@pytest.mark.slow
def test_vessels_darken_green_more_than_red(tube, baked):
    bare = bake_appearance(tube, seed=4, mucosa=replace(MUCOSAE["colon"], vessel_contrast=0.0))
    kept = decode(baked.albedo) / decode(bare.albedo)
    vessel = kept[..., 1] < 0.8
    assert 0.02 < vessel.mean() < 0.5
    assert (kept[vessel, 0] > kept[vessel, 1]).mean() > 0.99
    assert np.median(kept[~vessel, 1]) > 0.9


def test_relief_scales_with_its_slope(tube):
    bare = {"vessel_contrast": 0.0, "pit_slope": 0.0, "flecks": 0.0, "mucus": 0.0}
    plain = replace(MUCOSAE["colon"], **bare)
    heights = [
        bake_appearance(tube, seed=1, mucosa=replace(plain, relief_slope=slope), texels_per_mm=4.0)
        for slope in (0.05, 0.10)
    ]
    np.testing.assert_allclose(heights[1].height, 2.0 * heights[0].height, atol=1.5 * HEIGHT_STEP)


@pytest.mark.slow
def test_relief_has_the_slope_it_is_given(tube):
    """RMS slope over texels near 0.7 ⊕ 1 ⊕ 1 shares, up to the texels' band limit."""
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
    assert slope == pytest.approx(0.1 * np.hypot(np.hypot(0.7, 1.0), 1.0), rel=0.25)


@pytest.mark.parametrize("breaks", [0.0, 0.6, 1.0])
def test_villi_agree_with_their_readable_twin(breaks):
    """Height = depth · S((d₂ − d₁) / 0.38) with d to the cells' points, at the wound place.

    Breaks blend it with strokes: positive noise, stretched in one direction.
    """
    side, seed, spacing, slope = 6.0 * MM, 9, 0.5 * MM, 0.2
    mucosa = Mucosa(
        base_color=(0.5,) * 3,
        vessel_contrast=0.0,
        relief_slope=0.0,
        flecks=0.0,
        mucus=0.0,
        pit_spacing=spacing,
        pit_slope=slope,
        pit_breaks=breaks,
    )
    height = bake_appearance(make_square(side), seed=seed, mucosa=mucosa, texels_per_mm=16.0).height
    rows, columns = height.shape
    pixels = np.random.default_rng(1).integers(
        [rows // 4, columns // 4], [rows * 3 // 4] * 2, (500, 2)
    )
    u, v = (pixels[:, 1] + 0.5) / columns, 1.0 - (pixels[:, 0] + 0.5) / rows
    point = np.stack([u - 0.2, v - 0.2, 0.0 * u], axis=-1) / 0.6 * side / MM
    wind = 0.75 * displacement(31 * seed + 7, 3.1, point)
    wind += 0.2 * displacement(31 * seed + 8, 1.1, point)
    turn = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])
    place = (point + wind * [1.0, 1.0, 0.0]) @ turn.T
    ridge = np.array([0.48, 0.64, 0.6])
    along = (place @ ridge)[:, None] * ridge
    stretched = 3.5**0.5 * (place - along) + 3.5**-0.5 * along
    gap = cell_border(seed ^ 0x70697473, spacing / MM, place) / 0.38
    stroke = gradient_noise(31 * seed + 22, spacing / MM, stretched) / 1.4
    gap, stroke = (t * t * (3.0 - 2.0 * t) for t in np.clip([gap, stroke], 0.0, 1.0))
    plateau = 0.62 + (1.0 - breaks) * (gap - 0.62) - breaks * (stroke - 0.2)
    expected = slope * spacing / (3.5 - 1.1 * breaks) * plateau
    np.testing.assert_allclose(
        height[pixels[:, 0], pixels[:, 1]], expected, rtol=0.0, atol=1e-3 * slope * spacing
    )


@pytest.mark.parametrize("breaks", [0.0, 1.0])
def test_villi_have_the_slope_they_are_given(breaks):
    plain = Mucosa((0.5,) * 3, vessel_contrast=0.0, relief_slope=0.0, flecks=0.0)
    mucosa = replace(plain, pit_slope=0.2, pit_breaks=breaks)
    height = bake_appearance(
        make_square(12.0 * MM), seed=2, mucosa=mucosa, texels_per_mm=30.0
    ).height
    inner = height[tuple(slice(n // 4, -n // 4) for n in height.shape)]
    texel = 12.0 * MM / 0.6 / len(height)
    slope = np.sqrt(sum((np.diff(inner, axis=axis) ** 2).mean() for axis in (0, 1))) / texel
    assert slope == pytest.approx(0.2, rel=0.15)


def test_segments_differ_in_villi_bile_and_vessels():
    """Ileum has shorter villi and less bile than jejunum of the same patient."""
    jejunum, ileum, other = (
        bake_appearance(make_square(12.0 * MM, ("background", name)), seed=3, mucosa="small-bowel")
        for name in ("jejunum", "ileum", "wall")
    )
    assert ileum.height.std() < other.height.std() < jejunum.height.std()
    blue, red = (
        [decode(look.albedo)[..., c].mean() for look in (jejunum, other, ileum)] for c in (2, 0)
    )
    assert blue[0] / red[0] < blue[1] / red[1] < blue[2] / red[2]


@pytest.mark.slow
def test_flecks_of_mucus_cover_their_share():
    """Flecks are pale, small and apart; there are none without."""
    bare, flecked = (
        decode(
            bake_appearance(
                make_square(60.0 * MM),
                seed=3,
                mucosa=replace(MUCOSAE["stomach"], flecks=flecks),
                texels_per_mm=6.0,
            ).albedo
        )
        for flecks in (0.0, 1.0)
    )
    is_fleck = np.abs(flecked - bare).max(axis=-1) > 0.02
    assert 0.0005 < is_fleck.mean() < 0.05
    assert (flecked[is_fleck].mean(axis=-1) > bare[is_fleck].mean(axis=-1)).mean() > 0.95


def test_patchiness_is_the_share_of_variation_within_centimeters():
    """The color of a square of 20 mm varies less with fewer patches."""
    plain = replace(MUCOSAE["small-bowel"], flecks=0.0, pit_shade=0.0, network=0.0)
    spreads = [
        decode(
            bake_appearance(
                make_square(20.0 * MM),
                seed=3,
                mucosa=replace(plain, vessel_contrast=0.0, patchiness=patchiness),
                texels_per_mm=4.0,
            ).albedo
        )[20:-20, 20:-20].std(axis=(0, 1))
        for patchiness in (0.0, 0.5, 1.0)
    ]
    assert (spreads[0] < 0.75 * spreads[2]).all()
    assert (spreads[0] < spreads[1]).all()
    assert (spreads[1] < spreads[2]).all()


def test_gaps_between_villi_vary_over_the_wall():
    """They are deeper at some places than at others, by no more than a factor of 1.8."""
    plain = replace(MUCOSAE["small-bowel"], flecks=0.0, relief_slope=0.0)
    depths = []
    for variation in (0.0, 0.6):
        mucosa = replace(plain, vessel_contrast=0.0, pit_variation=variation)
        relief = bake_appearance(
            make_square(40.0 * MM), seed=3, mucosa=mucosa, texels_per_mm=10.0
        ).height
        middle = relief[200:440, 200:440].reshape(12, 20, 12, 20)
        depths.append(middle.std(axis=(1, 3)))
    ratio = depths[1] / depths[0]
    assert ratio.max() > 1.3 * ratio.min()
    assert ratio.max() < 1.81


@pytest.mark.slow
def test_the_wall_does_not_repeat():
    """The wall's color is correlated with itself at no distance beyond its largest patches."""
    side, mucosa = 120.0 * MM, replace(MUCOSAE["colon"], vessel_contrast=0.0)
    look = bake_appearance(make_square(side), seed=5, mucosa=mucosa, texels_per_mm=3.0)
    green = decode(look.albedo)[..., 1]
    fine = green[tuple(slice(n * 21 // 100, n * 79 // 100) for n in green.shape)]
    # Only what is finer than 5 mm can show repetition; large patches are few in a square.
    spectrum = np.fft.fft2(fine - fine.mean())
    frequency = np.hypot(*np.meshgrid(*[np.fft.fftfreq(n, 1 / 3.0) for n in fine.shape[::-1]]))
    power = np.abs(spectrum * (frequency > 0.2)) ** 2
    correlation = np.fft.ifft2(power).real
    correlation /= correlation[0, 0]
    correlation[:30, :30] = correlation[-30:, :30] = 0.0
    correlation[:30, -30:] = correlation[-30:, -30:] = 0.0
    assert np.abs(correlation).max() < 0.05


def test_the_wet_film_differs_by_patient_unless_it_is_set(tube):
    def strengths(mucosa: str | Mucosa) -> np.ndarray:
        baked = (
            bake_appearance(tube, seed=seed, mucosa=mucosa, texels_per_mm=0.5) for seed in range(40)
        )
        return np.array([look.clearcoat for look in baked])

    own = strengths("small-bowel")
    assert np.log(own).std() == pytest.approx(0.9, rel=0.3)
    assert np.median(own) == pytest.approx(0.08, rel=0.3)
    assert own.max() <= 1.0
    assert (strengths(MucosaSettings(clearcoat=0.3).of("small-bowel")) == 0.3).all()
    varied = MucosaSettings(clearcoat=0.3, clearcoat_variation=0.2).of("small-bowel")
    assert np.log(strengths(varied)).std() == pytest.approx(0.2, rel=0.3)
    assert (strengths("colon") == 0.8).all()


def test_errors_say_what_is_wrong(tube):
    with pytest.raises(UnknownNameError, match=r"No mucosa named 'colom'\. Known: colon"):
        bake_appearance(tube, seed=0, mucosa="colom")
    with pytest.raises(InputError, match="one pair for each corner"):
        bake_appearance(replace(tube, uv=tube.uv[:5]), seed=0)
    with pytest.raises(InputError, match="finite"):
        bake_appearance(replace(tube, uv=np.full_like(tube.uv, np.nan)), seed=0)
    with pytest.raises(InputError, match="have zero area on most"):
        bake_appearance(replace(tube, uv=np.zeros_like(tube.uv)), seed=0)
    with pytest.raises(InputError, match="parts of the wall share texels"):
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
    assert pale.clearcoat_gloss == Mucosa(base_color=(0, 0, 0)).clearcoat_gloss


@pytest.mark.parametrize(
    ("names", "name", "mucosa"),
    [
        (("small_bowel",), "sm", "small-bowel"),  # TotalSegmentator's
        (("duodenum",), "1", "small-bowel"),
        (("stomach",), "colon", "stomach"),  # the label before the name
        (("wall",), "stomach", "stomach"),
        (("wall",), "small-bowel", "small-bowel"),
        (("wall",), "a", "colon"),
        (("caecum",), "stomach", "colon"),
        (("antrum", "caecum"), "full-tract", "colon"),  # most of the wall
        (("duodenum", "ileum"), "full-tract", "small-bowel"),
    ],
)
def test_labels_choose_the_mucosa(names: tuple[str, ...], name: str, mucosa: str) -> None:
    tube = make_tube()
    label = np.full(len(tube.vertices), len(names), np.uint8)
    label[: len(label) // 3] = 1
    organ = replace(tube, name=name, label=label, label_names=("background", *names))
    assert own_mucosa(organ) == mucosa


@pytest.mark.slow
def test_mucus_covers_its_share_of_the_wall():
    """Film and strands that change green light by a tenth: a third of the share it begins on."""
    square = make_square(160.0 * MM)
    bare = replace(MUCOSAE["colon"], flecks=0.0, mucus=0.0)
    dry, thin, thick = (
        decode(
            bake_appearance(
                square, seed=4, mucosa=replace(bare, mucus=mucus), texels_per_mm=1.0
            ).albedo
        )[..., 1]
        for mucus in (0.0, 0.1, 0.3)
    )
    assert 0.025 < (thin / dry > 1.1).mean() < 0.045
    assert 0.075 < (thick / dry > 1.1).mean() < 0.135


def test_mucus_follows_the_palette():
    """Half the base color makes the whole wall half as bright, including mucus."""
    square = make_square(60.0 * MM)
    # With more bile, blue is cut at its minimum below the mucus, where the mask does not show it.
    mucosa = replace(MUCOSAE["colon"], mucus=0.5, bile=0.2)
    dark = replace(mucosa, base_color=tuple(0.5 * c for c in mucosa.base_color))
    full, half = (
        decode(bake_appearance(square, seed=4, mucosa=character, texels_per_mm=2.0).albedo)
        for character in (mucosa, dark)
    )
    seen = (half > 0.02).all(axis=-1) & (full < 0.9).all(axis=-1)  # neither cut nor coarse
    off = np.abs(half[seen] / full[seen] - 0.5)
    assert np.quantile(off, 0.999) < 0.03
