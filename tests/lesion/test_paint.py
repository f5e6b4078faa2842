from dataclasses import replace

import numpy as np
import pytest

from vrcaps.core.errors import InputError
from vrcaps.core.units import MM
from vrcaps.lesion import Colitis, Location, Polyp, add_lesions
from vrcaps.lesion.paint import Chart, assemble, pack, smoothed
from vrcaps.mesh.rasterize import sample
from vrcaps.organ.surface import Appearance


def images(width, height, value=0):
    return (
        np.full((height, width, 3), value, np.uint8),
        np.full((height, width), value, np.uint8),
        np.full((height, width), value, np.float32),
    )


def charts_of(*shapes):
    return [
        Chart(k + 1, np.zeros(2), 1.0, images(w, h, k + 1), images(w, h, 100 + k))
        for k, (w, h) in enumerate(shapes)
    ]


@pytest.mark.parametrize("sides", [(64, 400), (400, 64), (200, 200)])
def test_charts_lie_apart_beside_the_wall(sides):
    rng = np.random.default_rng(0)
    base = Appearance(*images(*sides, 7))
    charts = charts_of(*rng.integers(10, 90, (12, 2)).tolist())
    atlas = pack(base, np.array([[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]]), charts)
    whole = assemble(base, charts, atlas, lesioned=True).roughness
    assert whole.shape == atlas.size[::-1]
    assert (whole[-sides[1] :, : sides[0]] == 7).all()
    for k, chart in enumerate(charts):
        assert (whole == 100 + k).sum() == chart.clean[1].size
    assert (assemble(base, charts, atlas, lesioned=False).roughness == 5).sum() == charts[4].clean[
        1
    ].size


def test_wrapped_texture_is_continued():
    """Coordinates beyond 1 meet the same texels as before, where the texture wrapped."""
    rng = np.random.default_rng(0)
    roughness = rng.integers(0, 256, (48, 32)).astype(np.uint8)
    base = replace(Appearance(*images(32, 48)), roughness=roughness)
    uv = np.array([[[0.2, 0.1], [1.4, 0.1], [1.4, 1.25]]])
    charts = charts_of((20, 20))
    atlas = pack(base, uv, charts)
    whole = assemble(base, charts, atlas, lesioned=False).roughness
    places = rng.uniform(0.02, (1.38, 1.23), (500, 2))
    scaled = places * (32 / atlas.size[0], 48 / atlas.size[1])
    value = np.arange(256.0)
    assert sample(whole, scaled, value) == pytest.approx(sample(roughness, places, value))


def test_too_large():
    base = Appearance(*images(8, 4096))
    with pytest.raises(InputError, match="Make fewer or smaller lesions"):
        pack(base, np.zeros((1, 3, 2)), charts_of((700, 4000)) * 24)


def test_plain_color_leaves_blank_texels_out():
    look = Appearance(*images(64, 64, 128))
    look.albedo[:, 40:] = 0
    plain = smoothed(look).plain
    assert plain.min() == pytest.approx(plain.max())


@pytest.mark.slow
def test_painted_texture_differs_only_on_its_chart(tube):
    polyp = Polyp(size=6 * MM, location=Location(arc_length=80 * MM, theta=0.0))
    patient = add_lesions(tube, [polyp], np.random.default_rng(0))
    lesioned, clean = patient.organ.appearance, patient.clean.appearance
    apart = (lesioned.albedo != clean.albedo).any(axis=2)
    height, width = tube.appearance.albedo.shape[:2]
    assert apart.any()
    assert not apart[-height:, :width].any()
    assert np.array_equal(clean.albedo[-height:, :width], tube.appearance.albedo)


@pytest.mark.slow
def test_painting_in_place_leaves_the_given_organ_and_the_clean_twin(tube):
    middle = Location(arc_length=80 * MM)
    lesions = [Colitis(mayo=mayo, spread=15 * MM, location=middle) for mayo in (1, 3)]
    before = tube.appearance.albedo.copy()
    patient = add_lesions(tube, lesions, np.random.default_rng(0))
    height, width = before.shape[:2]
    assert np.array_equal(tube.appearance.albedo, before)
    assert np.array_equal(patient.clean.appearance.albedo[-height:, :width], before)
    assert not np.array_equal(patient.organ.appearance.albedo[-height:, :width], before)
