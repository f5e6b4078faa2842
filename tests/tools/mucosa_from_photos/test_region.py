from __future__ import annotations

import numpy as np
import pytest

from vrcaps.tools.mucosa_from_photos.patches import remove_shading
from vrcaps.tools.mucosa_from_photos.region import box_region, find_region


def test_the_even_part_is_found() -> None:
    """Stripes everywhere but in one square."""
    rng = np.random.default_rng(0)
    image = rng.normal(-1.0, 0.02, (256, 256, 3))
    image += 0.8 * np.sign(np.sin(np.arange(256) / 6.0))[:, None, None]
    image[90:220, 30:160] = rng.normal(-1.0, 0.02, (130, 130, 3))
    found = find_region(image, np.ones((256, 256), bool), 256)
    assert found is not None
    assert found.side >= 80
    assert found.row >= 85
    assert found.row + found.side <= 225
    assert found.column >= 25
    assert found.column + found.side <= 165


def test_no_region_where_too_little_is_usable() -> None:
    usable = np.zeros((256, 256), bool)
    usable[:, :40] = True
    assert find_region(np.zeros((256, 256, 3)), usable, 256) is None


def test_flattening_takes_a_smooth_light_out() -> None:
    """I = R · L with slow L: what comes back is R, up to a factor, at 5 % of L's spread."""
    rng = np.random.default_rng(0)
    albedo = rng.normal(0.0, 0.05, (200, 200, 3))
    y, x = np.mgrid[:200, :200] / 200.0
    light = -2.0 * ((x - 0.4) ** 2 + (y - 0.6) ** 2)
    flat = remove_shading(albedo + light[..., None], np.ones((200, 200), bool), 200)
    inner = np.s_[30:-30, 30:-30]
    error = (flat - albedo)[inner] - (flat - albedo)[inner].mean(axis=(0, 1))
    assert error.std() < 0.05 * light.std()


def test_a_box_is_cut_to_its_middle_square() -> None:
    region = box_region((10, 20, 100, 60), (200, 300))
    assert (region.row, region.column, region.side) == (20, 30, 60)


@pytest.mark.parametrize(
    ("box", "match"),
    [((0, 0, 30, 100), "Allowed: 48 px or more"), ((250, 0, 100, 100), "reaches beyond")],
)
def test_impossible_boxes(box: tuple[int, int, int, int], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        box_region(box, (200, 300))
