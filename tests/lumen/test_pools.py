"""Liquid finds its level; what is under it is borne up as Archimedes says."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from tests.support.tubes import straight_gut, tube_about
from vrcaps.core.units import MM
from vrcaps.lumen.contents import Liquid
from vrcaps.lumen.pools import cut_sections, find_pools, level_pools, submerged
from vrcaps.organ.surface import OrganSurface

RADIUS = 10.0 * MM
BEND = 40.0 * MM


def wave(crests: tuple[float, ...]) -> OrganSurface:
    """A tube that goes up and down: crests at given heights, dips at 0, both ends high."""
    x = np.linspace(0.0, 1.0, 60)
    heights = [60.0 * MM, *(h for crest in crests for h in (0.0, crest)), 0.0, 60.0 * MM]
    ease = 0.5 - 0.5 * np.cos(np.pi * x)
    z = np.concatenate([a + (b - a) * ease for a, b in pairwise(heights)])
    points = np.stack([np.linspace(0, 0.06 * (len(heights) - 1), len(z)), 0 * z, z], 1)
    return tube_about(points, RADIUS, around=40)


def test_a_u_tube_holds_its_liquid_level_in_both_legs() -> None:
    """Legs of a U: the level of a volume V of liquid is where the bend and twice h legs hold V."""
    leg = np.linspace(0.12, 0.0, 100)[:-1]
    turn = np.linspace(0.0, np.pi, 120)
    down = np.stack([np.full_like(leg, -BEND), 0 * leg, leg], 1)
    bend = np.stack([-BEND * np.cos(turn), 0 * turn, -BEND * np.sin(turn)], 1)
    points = np.concatenate([down, bend, (down * [-1, 1, 1])[::-1]])
    organ = tube_about(points, RADIUS, around=40)
    fill = 0.6
    pools = find_pools(organ, cut_sections(organ), Liquid(fill=fill), np.eye(4))
    assert pools is not None and len(pools.levels) == 1
    length = np.pi * BEND + 0.24
    height = 0.5 * (fill * length - np.pi * BEND)
    assert abs(pools.levels[0] - height) < 1.0 * MM
    volume = np.pi * RADIUS**2 * fill * length
    assert abs(pools.volume[0] / volume - 1.0) < 0.01
    assert (pools.of_vertex == 1).mean() > 0.95


def test_a_lying_tube_is_filled_by_its_share() -> None:
    """Half full up to the axis; a tenth up to where the segment of a disc is a tenth of it."""
    organ = straight_gut({"bowel": 0.2}, radius=RADIUS, edge=1.0 * MM)
    chords = np.linspace(-1.0, 1.0, 20_001)
    share = (np.pi - np.arccos(chords) + chords * np.sqrt(1.0 - chords**2)) / np.pi
    for fill in (0.1, 0.3, 0.5):
        pools = find_pools(organ, cut_sections(organ), Liquid(fill=fill), np.eye(4))
        assert pools is not None
        levels = np.unique(pools.levels)
        expected = RADIUS * np.interp(fill, share, chords)
        np.testing.assert_allclose(levels, expected, atol=0.12 * RADIUS)


def test_liquid_spills_over_the_lower_crest() -> None:
    organ = wave((8.0 * MM,))
    sections = cut_sections(organ)
    little = find_pools(organ, sections, Liquid(fill=0.02), np.eye(4))
    assert little is not None and len(little.levels) == 2
    assert (little.levels < 8.0 * MM - RADIUS).all()
    # With more, both dips are full to the crest and one pool stands over it.
    much = find_pools(organ, sections, Liquid(fill=0.5), np.eye(4))
    assert much is not None and len(much.levels) == 1
    assert much.levels[0] > 8.0 * MM - RADIUS


def test_more_liquid_stands_higher() -> None:
    organ = wave((45.0 * MM,))
    sections = cut_sections(organ)
    volumes = []
    for fill in (0.03, 0.08, 0.18, 0.35):
        pools = find_pools(organ, sections, Liquid(fill=fill), np.eye(4))
        assert pools is not None
        volumes.append(pools.volume.sum())
    assert volumes == sorted(set(volumes))


def test_posture_moves_the_liquid() -> None:
    organ = wave((30.0 * MM,))
    sections = cut_sections(organ)
    over = np.diag([1.0, -1.0, -1.0, 1.0])
    upright = find_pools(organ, sections, Liquid(fill=0.1), np.eye(4))
    turned = find_pools(organ, sections, Liquid(fill=0.1), over)
    assert upright is not None and turned is not None
    assert len(upright.levels) == 2
    middle = organ.centerline.length / 2.0
    assert any(first < middle < last for first, last in turned.stretch)


def test_a_narrower_lumen_has_the_same_liquid_higher() -> None:
    """A lying tube, a third full, contracts evenly: the same area under a higher chord."""
    organ = straight_gut({"bowel": 0.2}, radius=RADIUS, edge=1.0 * MM)
    sections = cut_sections(organ)
    rest = find_pools(organ, sections, Liquid(fill=0.3), np.eye(4))
    assert rest is not None and rest.section_volume.sum() == pytest.approx(rest.volume.sum())
    chords = np.linspace(-1.0, 1.0, 20_001)
    share = (np.pi - np.arccos(chords) + chords * np.sqrt(1.0 - chords**2)) / np.pi
    for scale in (0.8, 1.25):
        wide = np.full(len(rest.section_volume), scale)
        moved = level_pools(organ, sections, rest.section_volume, np.eye(4), wide)
        expected = scale * RADIUS * np.interp(0.3 / scale**2, share, chords)
        np.testing.assert_allclose(moved.levels, expected, atol=0.1 * RADIUS)
        assert moved.section_volume.sum() == pytest.approx(rest.section_volume.sum(), rel=1e-12)
        back = level_pools(organ, sections, moved.section_volume, np.eye(4), np.ones(len(wide)))
        np.testing.assert_allclose(back.levels.mean(), rest.levels.mean(), atol=0.02 * RADIUS)


def test_a_contraction_drives_liquid_over_the_crest() -> None:
    organ = wave((8.0 * MM,))
    sections = cut_sections(organ)
    rest = find_pools(organ, sections, Liquid(fill=0.05), np.eye(4))
    assert rest is not None and len(rest.levels) == 2
    left = sections.arc_length < 0.5 * organ.centerline.length
    moved = level_pools(organ, sections, rest.section_volume, np.eye(4), np.where(left, 0.3, 1.0))
    assert moved.section_volume.sum() == pytest.approx(rest.section_volume.sum(), rel=1e-12)
    assert moved.section_volume[left].sum() < 0.6 * rest.section_volume[left].sum()
    assert moved.levels[-1] > rest.levels[-1]


def test_no_liquid_no_pools() -> None:
    organ = wave((30.0 * MM,))
    assert find_pools(organ, cut_sections(organ), Liquid(fill=0.0), np.eye(4)) is None


@pytest.mark.parametrize("tilt", [0.0, 0.4, 1.0, np.pi / 2])
def test_submerged_part_of_a_capsule(tilt: float) -> None:
    """Against points counted on a fine grid, and whole or not at all at the ends."""
    half, radius = 7.0 * MM, 5.5 * MM
    axis = half * np.array([np.sin(tilt), 0.0, np.cos(tilt)])
    ends = (-axis, axis)
    whole = np.pi * radius**2 * (2.0 * half + 4.0 / 3.0 * radius)
    volume, center = submerged(ends, radius, -1.0)
    assert volume == 0.0 and (center == 0.0).all()
    volume, center = submerged(ends, radius, 1.0)
    assert volume == pytest.approx(whole, rel=1e-4)
    np.testing.assert_allclose(center, 0.0, atol=1e-9)
    line = np.linspace(-13.0, 13.0, 105) * MM
    grid = np.stack(np.meshgrid(line, line, line, indexing="ij"), -1).reshape(-1, 3)
    foot = np.clip(grid @ axis / (axis @ axis), -1.0, 1.0)[:, None] * axis
    inside = grid[np.linalg.norm(grid - foot, axis=1) < radius]
    # Levels half-way between planes of the grid.
    for level in (-4.125 * MM, -1.125 * MM, 3.125 * MM):
        under = inside[inside[:, 2] < level]
        volume, center = submerged(ends, radius, level)
        assert volume == pytest.approx(len(under) * (line[1] - line[0]) ** 3, rel=0.03)
        np.testing.assert_allclose(center, under.mean(axis=0), atol=0.15 * MM)


def test_half_a_sphere() -> None:
    """Archimedes: half the volume, its center 3/8 of the radius below the middle."""
    radius = 6.0 * MM
    volume, center = submerged((np.zeros(3), np.zeros(3)), radius, 0.0)
    assert volume == pytest.approx(2.0 / 3.0 * np.pi * radius**3, rel=1e-3)
    assert center[2] == pytest.approx(-3.0 / 8.0 * radius, rel=1e-2)
