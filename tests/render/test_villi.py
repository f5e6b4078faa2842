"""Villi: length of the fringe, gaps seen from above, and channels that they leave alone."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.shapes import looking, make_camera, make_model, pinhole, tube
from tests.support.tubes import tube_about
from vrcaps import _core
from vrcaps.camera.camera import Led
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import rotation_from_vector, triangle_areas
from vrcaps.organ.segments import find_segment
from vrcaps.render import scene
from vrcaps.render.renderer import DEFAULT_CHANNELS, Renderer
from vrcaps.render.settings import RenderSettings

_SIZE = (400, 120)
_EDGE = 60
"""Last column of a near wall; the far one begins behind it."""
_FLAT = _EDGE - 16
"""Number of its columns that are too far from its edge to be darkened."""
_NEAR, _FAR = 8e-3, 30e-3
_FOCAL = 200.0
_LENGTH = 0.5e-3
_SPACING = 0.42e-3
_NONE = (0.0, 0.0, 0.0)
"""No diffusion of light in the tissue."""
_LEDS = tuple(Led((0.003 * np.cos(a), 0.003 * np.sin(a), 0.0)) for a in range(6))
_CAMERA = make_camera(pinhole(96), leds=_LEDS)


def _channels() -> list[np.ndarray]:
    """Channels of two planes across the view; pixels lie 40 µm apart on the near one."""
    distance = np.full(_SIZE, _FAR, np.float32)
    distance[:, : _EDGE + 1] = _NEAR
    row, column = np.mgrid[: _SIZE[0], : _SIZE[1]]
    weights = np.stack([row, column], axis=-1) / np.array(_SIZE)
    labels = np.ones(_SIZE, np.uint8)
    return [distance, np.zeros(_SIZE, np.int32), weights.astype("f4"), labels, 0 * labels]


def _wall(scale: float | tuple[float, float] = 1.0, along: float = 0.0) -> tuple[np.ndarray, ...]:
    """Shape of the wall for pixels 40 µm times `scale` apart, moved by `along` [m] over columns."""
    extent = np.multiply(scale, _NEAR / _FOCAL * np.array(_SIZE))
    vertices = np.array([[extent[0], along, 0.0], [0.0, extent[1] + along, 0.0], [0.0, along, 0.0]])
    # Aligned with the lattice of the cells, a plane would not pass through their middles.
    return vertices @ rotation_from_vector(np.array([0.7, -0.4, 0.9])).T, np.array([[0, 1, 2]])


def _raised(
    channels: list[np.ndarray], length: float = _LENGTH, gaps: float = 0.0, **changes
) -> np.ndarray:
    """Planes of a near wall of radiance 1 before a far one, black by default, with villi."""
    planes = np.full((3, *_SIZE), changes.get("behind", 0.0), np.float32)
    planes[:, :, : _EDGE + 1] = 1.0
    if changes.get("shadow"):
        planes[:, :, 25:35] = 0.0
    wall = changes.get("wall", _wall(changes.get("scale", 1.0)))
    by_label = [[0.0, value] + [0.0] * 254 for value in (length, gaps)]
    tissue = _SPACING, changes.get("diffusion", _NONE)
    focal = changes.get("focal", _FOCAL)
    _core.raise_villi(planes, tuple(channels), wall, by_label, tissue, focal)
    return planes


def test_villi_stand_out_by_their_length_and_differ():
    planes = _raised(_channels())
    assert (planes[:, :, :_FLAT] == 1.0).all()
    behind = planes[0, :, _EDGE + 1 :]
    longest = 1.5 * _LENGTH / _NEAR * _FOCAL
    assert not behind[:, int(longest + 1.5) :].any()
    # Opacity falls by a third and tone by a fifth to the tips; the tone is 0.7 to 0.9 of the wall
    # next to the edge.
    lengths = (behind > 0.25).sum(axis=1) * _NEAR / _FOCAL
    assert 0.4 * _LENGTH < lengths.mean() < 0.9 * _LENGTH
    assert lengths.std() > 0.15 * _LENGTH
    # Villi are as far apart as their spacing: maxima along the outline, 16 mm long.
    smooth = np.convolve(lengths, np.ones(5) / 5.0, "same")
    maxima = ((smooth[1:-1] > smooth[:-2]) & (smooth[1:-1] >= smooth[2:])).sum()
    assert 0.5 < maxima * _SPACING / 16e-3 < 1.5


def test_a_fringe_of_short_villi_is_a_soft_band():
    """At up to 1.5 pixels it is the same everywhere and fades up to the tallest villi."""
    focal = 1.4 * _NEAR / _LENGTH
    behind = _raised(_channels(), focal=focal)[0, 10:-10, _EDGE + 1 :]
    assert (behind == behind[0]).all()
    assert behind[0, 0] > 0.2
    assert (np.diff(behind[0, :3]) < 0.0).all()
    assert not behind[0, int(np.ceil(1.5 * 1.4)) :].any()


@pytest.mark.parametrize("focal", [60.0, 100.0])
def test_edges_of_folds_are_darker_as_if_round(focal):
    """A radius of 1 mm, up to 12 pixels: the density follows from the normal of a round edge."""
    near = _raised(_channels(), focal=focal)[:, 1:-1, : _EDGE + 1]
    assert (near == near[:, :1]).all()
    from_edge = np.arange(_EDGE, -1, -1) + 0.5
    inward = np.maximum(1.0 - from_edge / min(1e-3 * focal / _NEAR, 12.0), 0.0)
    density = 1.0 - np.sqrt(1.0 - inward**2)
    for plane, color in zip(near, (0.38, 0.51, 0.55), strict=True):
        np.testing.assert_allclose(plane[0], np.exp(-color * density), rtol=1e-5)


def test_edges_before_a_wall_next_to_them_are_not_darker():
    channels = _channels()
    channels[0][:, _EDGE + 1 :] = _NEAR + 0.9e-3
    assert (_raised(channels)[:, :, : _EDGE + 1] == 1.0).all()
    channels[0][:, _EDGE + 1 :] = _NEAR + 2e-3
    dark = _raised(channels)[1, :, _EDGE]
    assert ((dark > _raised(_channels())[1, :, _EDGE]) & (dark < 1.0)).all()


def test_narrow_villi_stick_together_in_tufts():
    """Villi of 2.5 pixels are drawn as tufts of 5 pixels, of the same mean length."""
    focal = 2.5 * _NEAR / (_SPACING / 2.2**0.5)
    behind = _raised(_channels(), focal=focal, scale=_FOCAL / focal)[0, :, _EDGE + 1 :]
    lengths = (behind > 0.3).sum(axis=1) * _NEAR / focal
    assert 0.4 * _LENGTH < lengths.mean() < 0.9 * _LENGTH
    smooth = np.convolve(behind.sum(axis=1), np.ones(3) / 3.0, "same")
    maxima = ((smooth[1:-1] > smooth[:-2]) & (smooth[1:-1] >= smooth[2:])).sum()
    span = _SIZE[0] * _NEAR / focal
    assert 0.25 < maxima * _SPACING / span < 0.8


def test_light_diffuses_in_the_tissue_red_light_farthest():
    """A shadow 0.4 mm wide becomes red in the middle; light of its surroundings is lost."""
    channels = _channels()
    planes = [
        _raised(channels, 1e-9, gaps=0.0, shadow=True, diffusion=diffusion)[:, 200]
        for diffusion in (_NONE, (0.22e-3, 0.16e-3, 0.1e-3))
    ]
    assert set(np.unique(planes[0][:, :_FLAT])) == {0.0, 1.0}
    red, green, blue = planes[1][:, 30]
    assert 0.4 > red > 1.3 * green > 3.0 * blue > 0.0
    assert (np.diff(planes[1][:, 34]) < 0.0).all()  # in the shadow
    assert (np.diff(planes[1][:, 36]) > 0.0).all()
    sums = [plane[:, :_FLAT].sum(axis=1) for plane in planes]
    np.testing.assert_allclose(sums[1], sums[0], rtol=0.02)
    assert not planes[1][:, _EDGE + 2 :].any()  # nor does it reach the wall behind


def test_lengths_scale_with_the_setting():
    means = [_raised(_channels(), k * _LENGTH)[0, :, _EDGE + 1 :].sum() for k in (0.5, 1.0)]
    assert means[1] / means[0] == pytest.approx(2.0, rel=0.2)
    assert not _raised(_channels(), 0.0)[:, :, _EDGE + 1 :].any()


@pytest.mark.parametrize("gaps", [0.0, 0.7])
def test_villi_stay_on_the_wall(gaps):
    channels = _channels()
    moved = [np.roll(channel, 7, axis=0) for channel in channels]
    still, shifted = _raised(channels, gaps=gaps), _raised(moved, gaps=gaps)
    assert np.allclose(np.roll(still, 7, axis=1)[:, 20:-20], shifted[:, 20:-20], atol=1e-5)


def test_there_are_none_behind_what_floats_in_front():
    channels = _channels()
    channels[4][:200] = 1
    planes = _raised(channels)
    assert not planes[:, :200, _EDGE + 1 :].any()
    assert planes[:, 215:, _EDGE + 1 :].any()


def test_gaps_between_villi_are_a_dark_network():
    planes = _raised(_channels(), gaps=0.7, scale=2.0)[:, 1:-1, 1:_FLAT]
    density = -np.log(planes)
    assert np.allclose(density[0], 0.45 * density[1], atol=1e-5)
    assert np.allclose(density[2], 1.1 * density[1], atol=1e-5)
    # The density of a gap is 0.7 relative to the tip of a villus, up to 2.5 times that in a patch;
    # from the front, 0.63 times that.
    assert abs(density[1].mean()) < 0.02 * 0.7
    assert 0.9 * 0.441 < np.ptp(density[1]) < 2.5 * 1.001 * 0.441
    is_gap = density[1] > 0.0
    # Gaps across a line as long as the spacing of villi, on average: fewer along the leaves.
    starts = [np.maximum(np.diff(is_gap.astype(int), axis=axis), 0).mean() for axis in (0, 1)]
    along, across = np.array(starts) * _SPACING * _FOCAL / (2.0 * _NEAR)
    assert 0.4 < is_gap.mean() < 0.6
    assert 0.7 < across < 1.2
    assert across > 1.7 * along


def test_the_density_of_gaps_differs_between_patches():
    density = -np.log(_raised(_channels(), gaps=0.7, scale=2.0)[1, :390, 1:_FLAT])
    # Tiles of 2.4 by 4.1 mm, in patches of 5 mm; of equal gaps, tiles differ by 11 %.
    tiles = density.reshape(13, 30, -1)
    spread = tiles.std(axis=(1, 2))
    assert spread.max() > 1.8 * spread.min()
    assert spread.min() > 0.01
    # Of equal gaps, all tiles have a range of 0.441.
    assert np.median(np.ptp(tiles, axis=(1, 2))) == pytest.approx(0.441, rel=0.3)


def test_gaps_of_villi_near_the_dome_are_fainter():
    """Villi of 7.1 pixels have 0.48 of the gaps of villi of 3.5 pixels, at the same place."""
    far, near = (
        -np.log(_raised(_channels(), gaps=0.7, scale=scale)[1, 1:-1, 1:_FLAT])
        for scale in (2.0, 1.0)
    )
    far = far[: len(near) // 2, : _FLAT // 2]
    assert np.ptp(near) == pytest.approx(0.48 * np.ptp(far), rel=0.05)


def _aslant(tangent: float, scale: float) -> np.ndarray:
    """Density of gaps in a wall that falls away by `tangent` from column to column."""
    channels = _channels()
    channels[0][:, : _EDGE + 1] *= np.exp(tangent * (np.arange(_EDGE + 1) - _EDGE) / _FOCAL)
    return -np.log(_raised(channels, gaps=0.7, scale=scale)[1, 1:-1, 1:_FLAT])


@pytest.mark.parametrize("tangent", [0.4, 1.0, 3.0])
def test_gaps_of_tufts_in_a_slanting_wall_are_streaks_along_the_slope(tangent):
    """They are means over 2.5 widths of villi times the tangent, of up to 2, in three samples."""
    scale = 5.8  # pixels of 230 µm, which do not resolve villi
    lean = 2.5 * _SPACING / 2.2**0.5 * min(tangent, 2.0) / 3.0
    walls = [_wall(scale, along) for along in (-lean, 0.0, lean)]
    samples = [_raised(_channels(), gaps=0.7, wall=wall)[1, 1:-1, 1:_FLAT] for wall in walls]
    # The squared sine is the weight of 1.4 against 0.63.
    factor = (0.63 + (1.4 - 0.63) * tangent**2 / (1.0 + tangent**2)) / 0.63
    expected, found = -factor * np.log(samples).mean(axis=0), _aslant(tangent, scale)
    error = np.abs(found - expected)
    # The patches of the samples differ, as they are moved by up to 0.3 mm.
    assert np.quantile(error, 0.99) < 0.05 * np.ptp(found)
    assert error.max() < 0.15 * np.ptp(found)


def test_gaps_of_villi_in_a_slanting_wall_are_streaks_along_the_slope():
    """At 45°, samples are 0.24 mm apart, which is 6 columns; in a facing wall that is a villus."""

    def correlation(density: np.ndarray, columns: int) -> float:
        return float(np.corrcoef(density[:, columns:].ravel(), density[:, :-columns].ravel())[0, 1])

    facing, aslant = (correlation(_aslant(tangent, 1.0), 6) for tangent in (0.0, 1.0))
    assert aslant > facing + 0.25


@pytest.mark.parametrize(
    ("scale", "contrast"),
    [(2.0, True), (9.5, False), ((2.0, 1.2), True), ((2.0, 0.4), False), ((0.4, 2.0), False)],
)
def test_gaps_fade_where_pixels_do_not_resolve_them_or_the_wall_is_pulled(scale, contrast):
    # Pixels lie 80 or 380 µm apart, villi 420 µm; pulled walls have fewer per pixel on one side.
    planes = _raised(_channels(), gaps=0.7, scale=scale)[:, 1:-1, 1:_FLAT]
    assert (planes.std() > 0.05) == contrast
    assert contrast or (planes == 1.0).all()


def test_gaps_between_tufts_replace_those_between_villi_that_pixels_do_not_resolve():
    """Pixels 200 µm apart resolve tufts, 1.6 times as wide as villi, with 0.35 of their gaps."""
    resolved, tufts = (
        -np.log(_raised(_channels(), gaps=0.7, scale=scale)[1, 1:-1, 1:_FLAT])
        for scale in (2.0, 5.0)
    )
    # Strokes alone have more contrast than a network with strokes, and more patches are in view.
    assert 0.35 < np.ptp(tufts) / np.ptp(resolved) < 0.5
    is_gap = tufts > 0.0
    starts = np.maximum(np.diff(is_gap.astype(int), axis=1), 0).mean()
    # Across a line as long as the spacing of tufts.
    assert 0.3 < starts * 1.6 * _SPACING * _FOCAL / (5.0 * _NEAR) < 1.0


def test_villi_between_folds_in_contact_are_faint_and_shade_nothing():
    """Before a wall 1.1 mm behind their opacity is 0.4, and 1 before a far one."""
    contact = _channels()
    contact[0][:, _EDGE + 1 :] = _NEAR + 1.1e-3
    faint, solid = (
        1.0 - np.subtract(*(_raised(one, behind=light) for light in (0.2, 0.0)))[1] / 0.2
        for one in (contact, _channels())
    )
    ground = np.s_[2:-2, _EDGE + 1]
    assert faint[ground].max() == pytest.approx(0.4, abs=0.02)
    assert solid[ground].max() > 0.9
    assert (faint[2:-2, _EDGE + 20 :] == 0.0).all()


def test_long_villi_shade_the_wall_behind_them():
    """Between villi 12.5 pixels long, light falls to half at their ground, but for a soft tenth."""
    behind = _raised(_channels(), behind=0.2)[1, :, _EDGE + 10]
    expected = 1.0 - 0.5 * (1.0 - 10.0 / (1.5 * 12.5))
    assert 0.2 * expected < behind.min() < 0.2 * 1.1 * expected
    assert behind.max() > 0.3
    short = _raised(_channels(), length=2.0 * _NEAR / _FOCAL, behind=0.2)[1, :, _EDGE + 1 :]
    assert short.min() >= 0.2 - 1e-6


def test_the_shade_of_villi_differs_between_places():
    """Over 2.5 mm, or 62 rows, with several gaps each, it is up to 80 % less."""
    planes = [_raised(_channels(), behind=0.2, wall=_wall(1.0, 5e-3 * k)) for k in range(8)]
    parts = [part for plane in planes for part in np.array_split(plane[1, :, _EDGE + 10], 6)]
    shades = np.array([1.0 - part.min() / 0.2 for part in parts])
    assert 0.2 * shades.max() < shades.min() < 0.6 * shades.max()


def test_gaps_are_not_drawn_on_what_floats_in_front_or_without_villi():
    channels = _channels()
    channels[4][:200] = 1
    channels[3][300:] = 2
    planes = _raised(channels, gaps=0.7, scale=2.0)[:, :, : _EDGE + 1]
    assert (planes[:, :200] == 1.0).all()
    assert (planes[:, 300:] == 1.0).all()
    assert planes[:, 205:295].std() > 0.05


def _bowel(label: str = "jejunum"):
    organ = tube(40, 60, folds=0.4, capped=True)
    names = ("background", label)
    return make_model(replace(organ, label=np.ones_like(organ.label), label_names=names), _CAMERA)


def _frame(model, **settings):
    renderer = Renderer(model, RenderSettings(**settings))
    channels = (*DEFAULT_CHANNELS, "radiance")
    return renderer.render(looking((0.004, -0.003, 0.05)), _CAMERA, channels=channels)


def test_a_slack_wall_has_as_many_villi_as_at_rest():
    line = np.stack([np.zeros(60), np.zeros(60), np.linspace(0.0, 0.2, 60)], axis=1)
    organ, numbers = tube_about(line, 0.008, 40), []
    names = ("background", "jejunum")
    organ = replace(organ, label=np.ones_like(organ.label), label_names=names)
    for is_slack in (False, True):
        villi = scene.make_villi(organ, RenderSettings(), is_slack=is_slack)
        assert villi is not None
        numbers.append(triangle_areas(villi.vertices[organ.faces]).sum() / villi.spacing**2)
    assert numbers[1] == pytest.approx(numbers[0], rel=1e-3)
    assert villi.spacing == pytest.approx(scene.VILLUS_SPACING * scene.SLACK_WIDTH**0.5)


def test_only_light_changes():
    model = _bowel()
    frame, bare = _frame(model), _frame(model, villi=0.0)
    for name in DEFAULT_CHANNELS[1:]:
        assert np.array_equal(getattr(frame, name), getattr(bare, name), equal_nan=True), name
    assert (frame.radiance != bare.radiance).any(axis=-1).mean() > 0.002


def test_the_fringe_is_behind_outlines(monkeypatch):
    monkeypatch.setattr(scene, "GAP_DENSITY", 0.0)
    monkeypatch.setattr(scene, "DIFFUSION", _NONE)
    model = _bowel()
    frame, bare = _frame(model), _frame(model, villi=0.0)
    changed = (frame.radiance != bare.radiance).any(axis=-1)
    assert 0.002 < changed.mean() < 0.2
    rows, columns = np.nonzero(changed)
    reach = 6
    for row, column in zip(rows, columns, strict=True):
        window = np.s_[
            max(row - reach, 0) : row + reach + 1, max(column - reach, 0) : column + reach + 1
        ]
        assert np.nanmin(bare.ray_distance[window]) < bare.ray_distance[row, column] - 0.4e-3


def test_other_mucosae_and_direct_light_have_none():
    colon, bowel = _bowel("sigmoid"), _bowel()
    assert np.array_equal(_frame(colon).rgb, _frame(colon, villi=0.0).rgb)
    direct = {"light": "direct"}
    assert np.array_equal(_frame(bowel, **direct).rgb, _frame(bowel, villi=0.0, **direct).rgb)


def test_names_beyond_the_labels_have_none():
    model = _bowel()
    names = (*model.organ.label_names, *(f"region {k}" for k in range(255)))
    many = make_model(replace(model.organ, label_names=names), _CAMERA)
    assert np.array_equal(_frame(many).rgb, _frame(model).rgb)


def test_the_ileum_has_shorter_villi_than_the_jejunum():
    jejunum, ileum = find_segment("jejunum"), find_segment("ileum")
    assert jejunum is not None
    assert ileum is not None
    assert 0.0 < ileum.villi < jejunum.villi


def test_wrong_input():
    with pytest.raises(InputError, match="villi"):
        RenderSettings(villi=2.5)
    channels = _channels()
    with pytest.raises(ValueError, match="one size"):
        _raised([channels[0][1:], *channels[1:]])
    with pytest.raises(ValueError, match="does not exist"):
        _raised(channels, wall=(np.zeros((3, 3)), np.zeros((0, 3), int)))
    with pytest.raises(ValueError, match="does not exist"):
        _raised(channels, wall=(np.zeros((2, 3)), np.array([[0, 1, 2]])))
    by_label = [[0.0] * 256] * 2
    small, wall = np.zeros((3, 2, 2), np.float32), (np.zeros((3, 3)), np.zeros((1, 3), int))
    with pytest.raises(ValueError, match="channels' size"):
        _core.raise_villi(small, tuple(channels), wall, by_label, (_SPACING, _NONE), _FOCAL)
    planes = np.zeros((3, *_SIZE), np.float32)
    with pytest.raises(ValueError, match="above 0"):
        _core.raise_villi(planes, tuple(channels), wall, by_label, (0.0, _NONE), _FOCAL)
