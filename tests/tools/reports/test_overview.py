"""The organ's picture: silhouette and shading of shapes with a known outline."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support import tubes
from tests.support.shapes import with_ball
from vrcaps._core import Wall
from vrcaps.organ.surface import OrganSurface
from vrcaps.tools.reports.overview import marked_lesions, write_overview
from vrcaps.tools.reports.views import VIEWS, clear_place, inside_views, outside_view, project

RADIUS, LENGTH = 0.02, 0.2


@pytest.fixture(scope="module")
def tube() -> OrganSurface:
    return tubes.straight_tube(LENGTH, RADIUS, around=64, rings=41)


COLORS = np.array([[1.0, 1.0, 1.0], [0.2, 0.4, 0.9], [0.9, 0.3, 0.2]])


def test_silhouette_of_a_cylinder_from_the_side_is_a_rectangle(tube: OrganSurface) -> None:
    axes, center, half = np.eye(3)[[0, 2, 1]], np.array([0.0, 0.0, LENGTH / 2]), 0.12
    wall = Wall(tube.vertices, tube.faces)
    image = outside_view(tube, wall, axes, center, half, colors=COLORS, size_px=240)
    covered = np.mean(np.any(image < 1.0, axis=-1))
    assert covered == pytest.approx(2 * RADIUS * LENGTH / (2 * half) ** 2, rel=0.02)


def test_segments_have_their_colors(tube: OrganSurface) -> None:
    """Shading keeps the ratio of red and blue; the upper half has the second label."""
    label = np.where(tube.vertices[:, 2] > LENGTH / 2, 2, 1).astype(np.uint8)
    organ = replace(tube, label=label, label_names=("background", "first", "second"))
    axes, center, half = np.eye(3)[[0, 2, 1]], np.array([0.0, 0.0, LENGTH / 2]), 0.1
    wall = Wall(tube.vertices, tube.faces)
    image = outside_view(organ, wall, axes, center, half, colors=COLORS, size_px=101)
    for row, number in ((90, 1), (10, 2)):
        found, wanted = image[row, 50], COLORS[number]
        np.testing.assert_allclose(found[0] / found[2], wanted[0] / wanted[2], rtol=1e-6)


def test_a_point_is_projected_to_where_it_is_seen() -> None:
    axes, center = VIEWS["From the front"], np.array([0.1, 0.0, 0.0])
    np.testing.assert_allclose(project(np.array([0.3, 9.0, 0.5]), axes, center), [0.2, 0.5])
    for view in VIEWS.values():
        np.testing.assert_allclose(view @ view.T, np.eye(3), atol=1e-12)


def test_lesions_are_listed_with_and_without_records(tube: OrganSurface) -> None:
    near = np.hypot(tube.arc_length - 0.05, RADIUS * (tube.theta - 1.0)) < 0.008
    ill = replace(tube, instance=np.where(near, 3, 0).astype(np.uint16))
    (mark,) = marked_lesions(ill)
    assert (mark.instance, mark.text) == (3, "lesion")
    assert mark.arc_length == pytest.approx(0.05, abs=0.004)
    assert mark.theta == pytest.approx(1.0, abs=0.15)
    record = {
        **{"instance": 3, "kind": "polyp", "grade": "Ip", "specification": {"size": 0.012}},
        **{"arc_length_m": 0.06, "theta_rad": 0.9, "center_m": [0.0, 0.0, 0.06]},
    }
    (mark,) = marked_lesions(replace(ill, metadata={"lesions": [record]}))
    assert (mark.text, mark.arc_length, mark.theta) == ("polyp Ip 12 mm", 0.06, 0.9)
    assert marked_lesions(tube) == []


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [np.int32, np.int64])
def test_overview_is_an_image_file(tube: OrganSurface, dtype: type, tmp_path: Path) -> None:
    """Overview of a plain tube, and of one with many segments and a lesion."""
    from PIL import Image

    if dtype is np.int64:
        label = 1 + np.minimum(7 * tube.arc_length / LENGTH, 6).astype(np.uint8)
        names = ("background", *(f"part_{k}" for k in range(1, 8)))
        ill = np.where(np.hypot(tube.arc_length - 0.05, RADIUS * tube.theta) < 0.008, 1, 0)
        tube = replace(tube, label=label, label_names=names, instance=ill.astype(np.uint16))
    write_overview(replace(tube, faces=tube.faces.astype(dtype)), tmp_path / "tube.png")
    with Image.open(tmp_path / "tube.png") as image:
        assert image.width == 1540
        pixels = np.asarray(image.convert("RGB"))
    assert (np.ptp(pixels, axis=-1) > 60).mean() > 0.05


def test_inside_views_look_down_the_lumen(tube: OrganSurface) -> None:
    """The open far end is dark, the wall around it lit; exposure is regulated."""
    (image,) = inside_views(tube, [0.05])
    height, width = image.shape[:2]
    middle = image[height // 2 - 4 : height // 2 + 4, width // 2 - 4 : width // 2 + 4]
    assert middle.max() < 10
    ring = image[height // 2, width // 5]
    assert ring[0] > 60
    assert ring[0] > ring[2]


def test_a_view_is_taken_where_no_lesion_blocks_it(tube: OrganSurface) -> None:
    """Inside a ball and shortly before it there is nothing to see."""
    wall = Wall(tube.vertices, tube.faces)
    assert clear_place(tube, wall, 0.1) == 0.1
    organ = with_ball(tube, np.array([0.0, 0.0, 0.1]), 0.012)
    wall = Wall(organ.vertices, organ.faces)
    assert 0.11 < clear_place(organ, wall, 0.1) <= 0.13
    assert clear_place(organ, wall, 0.095) > 0.11
