"""Scans of known organs come back as those organs."""

import re
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from tests.support.phantom import coverage
from vrcaps._core import Wall as Surface
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.mesh.mesh import Mesh, wall_distance
from vrcaps.tools.ct.from_ct import (
    WallOptions,
    check_label,
    find_lumens,
    label_number,
    misplaced,
    organ_from_gas,
    organ_from_label,
)
from vrcaps.tools.ct.lumen import choose_gas
from vrcaps.tools.ct.volume import Volume

pytestmark = pytest.mark.slow

MM = 1e-3
COARSE = WallOptions(edge=3 * MM)
"""For what does not depend on precision."""


def from_gas(scan: Volume, wall: WallOptions | None = None, tagged_fluid: str | None = None):
    gas = find_lumens(scan)
    piece = choose_gas(gas, scan)[0]
    wall = wall or WallOptions()
    return organ_from_gas(scan, gas, piece, wall=wall, name="tube", tagged_fluid=tagged_fluid)


def distances(organ, truth: Mesh) -> np.ndarray:
    """Both ways, 3,000 vertices each [m]."""
    rng = np.random.default_rng(0)
    both = []
    for one, other in ((organ, truth), (truth, organ)):
        some = rng.choice(len(one.vertices), min(3000, len(one.vertices)), replace=False)
        both.append(wall_distance(one.vertices[some], other.vertices, other.faces))
    return np.concatenate(both)


def polyp_heights(organ, polyps) -> np.ndarray:
    """Height of each polyp in a wall, over half its diameter."""
    surface = Surface(organ.vertices, organ.faces.astype(np.int64))
    shares = []
    for polyp in polyps:
        top = polyp.diameter / 2 + 3 * MM
        down = surface.cast((polyp.foot + top * polyp.axis)[None], -polyp.axis[None].copy())[0][0]
        shares.append((top - float(down)) / (polyp.diameter / 2))
    return np.array(shares)


def check(organ, truth: Mesh, polyps) -> np.ndarray:
    """Distances to the truth, both ways [m]."""
    away = distances(organ, truth)
    assert away.mean() < 0.35 * MM
    assert np.quantile(away, 0.95) < 0.8 * MM
    assert (polyp_heights(organ, polyps) > 0.7).all()
    judge = trimesh.Trimesh(organ.vertices, organ.faces, process=False)
    assert judge.is_watertight
    assert judge.volume < 0.0
    return away


def test_gas(dry_scan, tube) -> None:
    organ = from_gas(dry_scan)
    assert check(organ, *tube).mean() < 0.2 * MM
    assert organ.appearance is None
    assert organ.label_names == ("background", "wall")
    assert organ.metadata["input_mode"] == "gas"
    assert organ.metadata["notes"] == []


def test_tagged_fluid_is_lumen_on_request_only(wet_scan, tube) -> None:
    truth, polyps = tube
    organ = from_gas(wet_scan, tagged_fluid="supine")
    away = check(organ, truth, polyps)
    # The first polyp, 3 mm high, stands right in the fluid's level: no lower for that.
    foot = truth.vertices[:, 1].max() - 0.012 - polyps[0].foot[1]
    assert abs(foot) < 1 * MM
    assert polyp_heights(organ, polyps[:1]) > 0.85
    assert np.quantile(away, 0.95) < 0.25 * MM
    dry = from_gas(wet_scan, COARSE)
    assert distances(dry, truth).mean() > 1 * MM


def test_bone_near_the_gut_is_no_fluid(dry_scan, tube) -> None:
    organ = from_gas(dry_scan, tagged_fluid="supine")
    check(organ, *tube)
    assert organ.metadata["notes"] == ["0 pools of tagged fluid added to the lumen"]


def test_a_posture_that_is_none(dry_scan) -> None:
    with pytest.raises(UnknownNameError, match=r"No posture named 'sitting'. Known: left-lateral"):
        from_gas(dry_scan, tagged_fluid="sitting")


def mask_of(tube, dry_scan) -> Volume:
    share = coverage(tube[0], dry_scan.T_patient_index, dry_scan.values.shape)
    return replace(dry_scan, values=(share > 0.5).astype(np.int16), source="mask")


def test_a_mask(dry_scan, tube) -> None:
    mask = mask_of(tube, dry_scan)
    organ = organ_from_label(
        mask, check_label(mask, "1"), wall=WallOptions(), name="m", label_name="gut"
    )
    check(organ, *tube)
    judge = trimesh.Trimesh(organ.vertices, organ.faces, process=False)
    assert -judge.volume == pytest.approx(mask.values.sum() * mask.voxel_volume, rel=0.02)
    assert organ.label_names == ("background", "gut")


@pytest.fixture(scope="module")
def collapsed(dry_scan, tube) -> tuple[Volume, float]:
    """The mask with 8 mm of its length closed, and the full length's centerline."""
    mask = mask_of(tube, dry_scan)
    index = np.argwhere(np.ones(mask.values.shape, bool))
    z = mask.points(index)[:, 2].reshape(mask.values.shape)
    middle = tube[0].vertices[:, 2].mean()
    values = np.where(np.abs(z - middle) < 4 * MM, 0, mask.values)
    return replace(mask, values=values.astype(np.int16)), middle


def test_a_collapsed_stretch_is_reported(collapsed) -> None:
    organ = organ_from_label(collapsed[0], 1, wall=COARSE, name="half")
    first, second = organ.metadata["notes"]
    assert first.startswith("collapsed segment left closed: ")
    assert "--bridge-mm" in first
    assert second.startswith("1 other parts left out (")


def test_a_collapsed_stretch_is_bridged(collapsed, tube) -> None:
    mask, middle = collapsed
    organ = organ_from_label(mask, 1, wall=replace(COARSE, bridge=12 * MM), name="whole")
    (note,) = organ.metadata["notes"]
    assert note.startswith("collapsed segment opened: ")
    assert organ.centerline.length == pytest.approx(np.ptp(tube[0].vertices[:, 2]), rel=0.06)
    at = np.argmin(np.abs(organ.centerline.points[:, 2] - middle))
    assert organ.centerline.radius[at] == pytest.approx(6 * MM, rel=0.15)


@pytest.fixture(scope="module")
def squeezed(dry_scan, tube) -> Volume:
    """The scan with 8 mm of the gut's length full of tissue."""
    z = dry_scan.points(np.argwhere(np.ones(dry_scan.values.shape, bool)))[:, 2]
    closed = np.abs(z.reshape(dry_scan.values.shape) - tube[0].vertices[:, 2].mean()) < 4 * MM
    values = np.where(closed & (dry_scan.values < -100), 40, dry_scan.values)
    return replace(dry_scan, values=values.astype(np.int16))


def test_a_collapsed_stretch_of_gas_is_reported(squeezed, tube) -> None:
    for bridge in (0.0, 4 * MM):
        organ = from_gas(squeezed, replace(COARSE, bridge=bridge))
        first, second = organ.metadata["notes"]
        assert re.match(r"collapsed segment left closed: \d+\.\d mm at .* ml; --bridge-mm", first)
        assert second.startswith("1 other parts left out (")
        assert organ.centerline.length < 0.55 * np.ptp(tube[0].vertices[:, 2])


def test_a_collapsed_stretch_of_gas_is_bridged(squeezed, tube) -> None:
    organ = from_gas(squeezed, WallOptions(bridge=12 * MM))
    (note,) = organ.metadata["notes"]
    assert note.startswith("collapsed segment opened: ")
    assert organ.centerline.length == pytest.approx(np.ptp(tube[0].vertices[:, 2]), rel=0.06)
    middle = tube[0].vertices[:, 2].mean()
    at = np.argmin(np.abs(organ.centerline.points[:, 2] - middle))
    assert organ.centerline.radius[at] == pytest.approx(6 * MM, rel=0.15)
    # Beyond the stretch the wall is the true one.
    near = np.abs(organ.vertices[:, 2] - middle) < 10 * MM
    away = wall_distance(organ.vertices[~near], tube[0].vertices, tube[0].faces)
    assert np.quantile(away, 0.95) < 0.4 * MM


def test_a_cut_lumen_is_capped_or_left_open(dry_scan, tube) -> None:
    middle = dry_scan.index(tube[0].vertices.mean(axis=0)[None])[0]
    part = dry_scan.crop((slice(0, int(middle[0])), slice(None), slice(None)))
    for open_ends in ("cap", "keep"):
        organ = from_gas(part, replace(COARSE, open_ends=open_ends))
        judge = trimesh.Trimesh(organ.vertices, organ.faces, process=False)
        assert judge.is_watertight == (open_ends == "cap")


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"edge": 0.5}, r"The edge length is 500 mm. Allowed: 0.1 to 20 mm"),
        ({"blur": -1.0}, r"The blur is -1 voxels. Allowed: 0 to 5"),
        ({"pass_band": 0.0}, r"The pass band is 0. Allowed: 0.001 to 2"),
        ({"bridge": -1.0}, r"The bridge width is -1000 mm. Allowed: 0 to 200 mm"),
    ],
)
def test_walls_that_cannot_be(given, text) -> None:
    with pytest.raises(InputError, match=text):
        WallOptions(**given)


def test_labels_by_number_and_name(dry_scan, tube) -> None:
    assert [label_number(x) for x in ("7", "colon", "stomach")] == [7, 20, 6]
    with pytest.raises(UnknownNameError, match="No label named 'liver'"):
        label_number("liver")
    with pytest.raises(InputError, match="Label 0 is background"):
        label_number("0")
    mask = mask_of(tube, dry_scan)
    with pytest.raises(InputError, match=r"No voxel of mask has label colon \(20\). Found: 1\."):
        check_label(mask, "colon")
    with pytest.raises(InputError, match="it is not a label map"):
        check_label(dry_scan, "1")


def test_labels_without_a_large_enough_part(dry_scan, tube) -> None:
    values = np.zeros_like(dry_scan.values)
    values[5, 5, 5] = 1
    with pytest.raises(InputError, match=r"has no part of 0\.2 ml or more"):
        organ_from_label(replace(dry_scan, values=values), 1, wall=WallOptions(), name="x")
    with pytest.raises(InputError, match="has label 2"):
        organ_from_label(replace(dry_scan, values=values), 2, wall=WallOptions(), name="x")


def test_labels_of_another_scan_are_suspect(dry_scan, tube) -> None:
    mask = mask_of(tube, dry_scan)
    assert misplaced(dry_scan, mask, 1) is None
    moved = replace(mask, values=np.roll(mask.values, -70, axis=1))
    line = misplaced(dry_scan, moved, 1)
    assert line is not None
    assert "lies in the air outside the body" in line
