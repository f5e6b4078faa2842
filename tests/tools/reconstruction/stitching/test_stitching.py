"""Stitching: each step against a known answer, and all of them on a flat wall."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from vrcaps.camera.camera import Camera, pixel_grid
from vrcaps.camera.lens import LensPinhole
from vrcaps.cli import main
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import rotation_from_vector, transform_from
from vrcaps.mesh.mesh import Mesh
from vrcaps.metrics.trajectory import Similarity
from vrcaps.recording.frame_sequence import FrameSequence
from vrcaps.tools.reconstruction.matching import connected
from vrcaps.tools.reconstruction.stitching.mosaic import (
    Mosaic,
    adjusted,
    blended,
    chained_homographies,
    mapped,
    usable,
)
from vrcaps.tools.reconstruction.stitching.surface import apply, depth_from_shading, register

cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed")

from vrcaps.tools.reconstruction.matching import (  # noqa: E402  # noqa: E402
    Pair,
    highlights,
    homography_pair,
    image_pairs,
    sift_features,
    without_highlights,
)
from vrcaps.tools.reconstruction.stitching.stitch import Stitched, StitchSettings, stitch  # noqa: E402
from vrcaps.tools.reconstruction.stitching.surface import (  # noqa: E402
    DepthSource,
    estimated_depth,
    surface_of,
    wall_surface,
)

SIDE = 160
LENS = LensPinhole(fx=100.0, fy=100.0, cx=79.5, cy=79.5)
CAMERA = Camera("front", LENS, SIDE, SIDE)
MATRIX = np.array([[100.0, 0.0, 79.5], [0.0, 100.0, 79.5], [0.0, 0.0, 1.0]])
DISTANCE = 0.03


def _mucosa(side: int, seed: int = 0) -> np.ndarray:
    """Smooth spots of red, without highlights."""
    chance = np.random.default_rng(seed)
    spots = sum(gaussian_filter(chance.standard_normal((side, side)), s) * s for s in (2, 5))
    gray = np.clip(120.0 + 90.0 * spots / np.abs(spots).max(), 0, 255)
    return (gray[..., None] * [1.0, 0.55, 0.45]).astype(np.uint8)


WALL = _mucosa(520)
"""The wall z = 30 mm, a pixel every 0.2 mm, its middle at the origin."""


def _poses(count: int = 4) -> np.ndarray:
    """Cameras that turn and move before the wall."""
    k = np.arange(count)[:, None]
    turns = np.array([0.02, -0.03, 0.01]) + k * np.array([0.02, 0.05, -0.03])
    places = 1e-3 * (np.array([-6.0, 2.0, 0.0]) + k * np.array([4.5, -1.5, 1.0]))
    return transform_from(rotation_from_vector(turns), places)


def _to_wall(pose: np.ndarray) -> np.ndarray:
    """Homography from pixels of a camera to pixels of the wall."""
    rotation, place = pose[:3, :3], pose[:3, 3]
    # A ray hits the plane at place + ray (DISTANCE - place_z) / ray_z.
    hit = np.stack(
        [
            (DISTANCE - place[2]) * rotation[0] + place[0] * rotation[2],
            (DISTANCE - place[2]) * rotation[1] + place[1] * rotation[2],
            rotation[2],
        ]
    )
    to_pixel = np.array([[5000.0, 0.0, 259.5], [0.0, 5000.0, 259.5], [0.0, 0.0, 1.0]])
    return to_pixel @ hit @ np.linalg.inv(MATRIX)


def _load(channel: str, index: int, count: int = 4) -> np.ndarray:
    pose = _poses(count)[index]
    if channel == "depth":
        rays = LENS.unproject(pixel_grid(SIDE, SIDE))
        along = rays @ pose[2, :3]
        return ((DISTANCE - pose[2, 3]) / along * rays[..., 2]).astype(np.float32)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return cv2.warpPerspective(WALL, _to_wall(pose), (SIDE, SIDE), flags=flags)


def _sequence(**more) -> FrameSequence:
    values = {"time": np.arange(4.0), "T_world_camera": _poses()}
    return FrameSequence("wall/front", ("rgb", "depth"), values, _load, CAMERA, **more)


def _homographies() -> dict[int, np.ndarray]:
    """From pixels of each camera to those of the first."""
    first = np.linalg.inv(_to_wall(_poses()[0]))
    found = {k: first @ _to_wall(pose) for k, pose in enumerate(_poses())}
    return {k: H / H[2, 2] for k, H in found.items()}


def test_highlights_are_found_and_inpainted():
    plain = _mucosa(200)
    y, x = np.mgrid[:200, :200]
    chance = np.random.default_rng(1)
    spots = np.zeros((200, 200), bool)
    for cx, cy in chance.uniform(20, 180, (10, 2)):
        spots |= (x - cx) ** 2 + (y - cy) ** 2 < chance.uniform(2, 4) ** 2
    shining = np.where(spots[..., None], 250, plain).astype(np.uint8)
    mask = highlights(shining)
    assert mask[spots].all()
    assert mask.sum() < 4 * spots.sum()
    clean = without_highlights(shining)
    error = np.abs(clean.astype(int) - plain)
    assert error[~mask].max() == 0
    assert error.max() <= 30
    assert error[spots].mean() <= 6
    assert not highlights(plain).any()


def test_homography_of_two_views_is_recovered():
    features = [sift_features(_load("rgb", k), 400) for k in (0, 1)]
    pair = homography_pair((0, 1), *features, tolerance=2.0)
    expected = np.linalg.inv(_homographies()[1])
    corners = np.array([[20.0, 20.0], [140.0, 20.0], [140.0, 140.0], [20.0, 140.0]])
    error = mapped(pair.homography, corners) - mapped(expected, corners)
    assert np.abs(error).max() < 0.5
    assert pair.num_matches >= len(pair.points_first) > 30
    other = sift_features(_mucosa(SIDE, seed=7), 400)
    assert homography_pair((0, 1), features[0], other, tolerance=2.0) is None
    blank = sift_features(np.full((SIDE, SIDE, 3), 90, np.uint8), 400)
    assert len(blank.points) == 0
    assert homography_pair((0, 1), features[0], blank, tolerance=2.0) is None


def test_all_pairs_are_found_in_any_order():
    order = [2, 0, 3, 1]
    features = [sift_features(_load("rgb", k), 400) for k in order]
    features.append(sift_features(_mucosa(SIDE, seed=7), 400))
    pairs = image_pairs(features, 2.0)
    assert {(p.first, p.second) for p in pairs} >= {(1, 3), (0, 3), (0, 2)}
    assert connected(len(features), pairs) == [0, 1, 2, 3]
    assert connected(3, []) == []


def _exact_pairs() -> list[Pair]:
    chance, exact, pairs = np.random.default_rng(2), _homographies(), []
    for i, j in ((0, 1), (1, 2), (2, 3), (0, 2)):
        there = np.linalg.inv(exact[j]) @ exact[i]
        points = chance.uniform(0.0, SIDE, (30, 2))
        pairs.append(Pair(i, j, there / there[2, 2], points, mapped(there, points), 40))
    return pairs


def test_bundle_adjustment_recovers_exact_homographies():
    pairs, exact = _exact_pairs(), _homographies()
    reference, found = chained_homographies(4, [0, 1, 2, 3], pairs)
    assert reference != 3  # at the end of the chain
    to_first = exact[reference]
    for k in found:
        np.testing.assert_allclose(to_first @ found[k], exact[k] * (to_first @ found[k])[2, 2])
    chance = np.random.default_rng(3)
    rough = {k: H + (k != reference) * chance.normal(0, 1e-5, (3, 3)) for k, H in found.items()}
    rough = {k: H / H[2, 2] for k, H in rough.items()}
    better = adjusted(rough, pairs, reference, (SIDE, SIDE))
    corners = np.array([[0.0, 0.0], [159.0, 0.0], [159.0, 159.0], [0.0, 159.0]])
    before, after = (
        max(np.abs(mapped(one[k], corners) - mapped(found[k], corners)).max() for k in found)
        for one in (rough, better)
    )
    assert before > 0.05
    assert after < 1e-4


def test_mosaic_shows_the_wall_and_its_depth_is_exact():
    """Depth of a flat wall under turns and moves: closed form by the homography's scale."""
    exact = _homographies()
    mosaic = blended(exact, CAMERA, lambda k: _load("rgb", k), lambda k: _load("depth", k), 0)
    rays = mosaic.camera.lens.unproject(pixel_grid(mosaic.camera.width, mosaic.camera.height))
    pose = _poses()[0]
    truth = (DISTANCE - pose[2, 3]) / (rays @ pose[2, :3]) * rays[..., 2]
    known = np.isfinite(mosaic.depth)
    assert known.mean() > 0.6
    assert mosaic.depth.shape[1] > 1.3 * SIDE
    np.testing.assert_allclose(mosaic.depth[known], truth[known], rtol=5e-3)
    np.testing.assert_allclose(np.median(mosaic.depth[known] / truth[known]), 1.0, atol=2e-4)
    lens = mosaic.camera.lens
    shift = np.array([[1.0, 0.0, 79.5 - lens.cx], [0.0, 1.0, 79.5 - lens.cy], [0.0, 0.0, 1.0]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    size = mosaic.rgb.shape[1::-1]
    wall = cv2.warpPerspective(WALL, _to_wall(pose) @ shift, size, flags=flags)
    error = np.abs(mosaic.rgb.astype(int) - wall)[known]
    assert error.mean() < 3.0  # the wall is interpolated twice
    assert np.percentile(error, 99) < 8.0


def test_what_a_lens_does_not_see_is_neither_matched_nor_shown():
    """A round field: its edge stays in place while the wall moves."""
    narrow = replace(CAMERA, image_circle_px=70.0)
    y, x = np.mgrid[:SIDE, :SIDE]
    is_round = np.hypot(x - 79.5, y - 79.5) <= 70.0

    def load(channel, index):
        image = _load(channel, index)
        if channel == "depth":
            return np.where(is_round, image, np.nan)
        return np.where(is_round[..., None], image, 0).astype(np.uint8)

    sequence = replace(_sequence(), camera=narrow, load=load)
    found = stitch(sequence, StitchSettings(num_features=400))
    shown = found.mosaic.rgb.max(axis=2)
    assert (shown > 0).mean() > 0.5
    assert shown[np.isfinite(found.mosaic.depth)].min() > 30  # no black rim within
    exact, best = _homographies(), max(found.pairs, key=lambda one: len(one.points_first))
    scale = found.sequence.camera.lens.fx / LENS.fx
    there = np.linalg.inv(exact[best.second]) @ exact[best.first]
    middle = np.array([[79.5, 79.5]])
    expected = (mapped(there, middle) - middle) * scale
    own = np.array([[found.sequence.camera.lens.cx, found.sequence.camera.lens.cy]])
    np.testing.assert_allclose(mapped(best.homography, own) - own, expected, atol=1.0)


def test_images_that_would_be_stretched_are_left_out():
    good = np.array([[1.0, 0.0, 30.0], [0.0, 1.0, 5.0], [0.0, 0.0, 1.0]])
    behind, large = good.copy(), np.diag([4.0, 4.0, 1.0])
    behind[2, 0] = -0.01
    assert list(usable({0: np.eye(3), 1: good, 2: behind, 3: large}, CAMERA)) == [0, 1]


def _ellipsoid() -> Mesh:
    import trimesh

    ball = trimesh.creation.icosphere(3, 1.0)
    bumps = 1.0 + 0.2 * np.sin(3.0 * ball.vertices[:, :1]) * np.cos(4.0 * ball.vertices[:, 1:2])
    return Mesh(np.asarray(ball.vertices) * bumps * [0.04, 0.025, 0.015], np.asarray(ball.faces))


@pytest.mark.parametrize("scale", [1.0, 1.04])
def test_icp_recovers_a_known_motion(scale):
    wall = _ellipsoid()
    corners = wall.vertices[wall.faces]
    points = corners.mean(axis=1)[corners.mean(axis=1)[:, 2] > -0.002]  # a part of the wall
    motion = Similarity(
        rotation_from_vector(np.array([0.05, -0.08, 0.06])), np.full(3, 1e-3), scale
    )
    given = (points - motion.translation) @ motion.rotation / motion.scale
    found = register(given, wall, scale=scale != 1.0)
    np.testing.assert_allclose(apply(found.similarity, given), points, atol=1e-6)
    np.testing.assert_allclose(found.similarity.rotation, motion.rotation, atol=1e-5)
    assert found.similarity.scale == pytest.approx(scale, abs=1e-5)
    assert found.rmse[0] > 1e-3
    with pytest.raises(InputError, match=r"points to register is 3\. Allowed: 10 or more"):
        register(given[:3], wall, scale=False)


def test_shading_gives_the_depth_of_a_tilted_wall():
    """I = cos θ / r² of a plane n · X = d, seen and lit from the origin."""
    normal = np.array([0.25, -0.1, 1.0]) / np.linalg.norm([0.25, -0.1, 1.0])
    lens = LensPinhole(fx=40.0, fy=40.0, cx=31.5, cy=31.5)
    rays = lens.unproject(pixel_grid(64, 64))
    cosine = rays @ normal
    depth = DISTANCE / cosine * rays[..., 2]
    light = cosine * (cosine / cosine.max()) ** 2
    srgb = np.where(light > 0.0031308, 1.055 * light ** (1 / 2.4) - 0.055, 12.92 * light)
    rgb = np.repeat(np.rint(255.0 * np.clip(srgb, 0, 1))[..., None], 3, axis=2).astype(np.uint8)
    rgb[:4] = 0
    found = depth_from_shading(rgb, Camera("front", lens, 64, 64))
    assert np.isnan(found[:4]).all()
    ratio = (found / depth)[10:-6, 6:-6]
    ratio /= np.median(ratio)
    assert np.sqrt(np.mean((ratio - 1.0) ** 2)) < 0.02


@pytest.mark.slow
def test_a_flat_wall_is_stitched_from_the_command_line(tmp_path, monkeypatch, capsys):
    ends = 0.05 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    corners = np.concatenate([ends, np.full((4, 1), DISTANCE)], axis=1)
    truth = Mesh(corners, np.array([[0, 2, 1], [0, 3, 2]]))
    sequence = replace(_sequence(), episode=SimpleNamespace(organ=truth))
    monkeypatch.setattr("vrcaps.formats.io.read_source", lambda *_: (sequence,))
    source, out = tmp_path / "wall", tmp_path / "out"
    source.mkdir()
    flags = ["--method", "stitching", "--field-of-view-deg", "75", "--out", str(out)]
    main(["reconstruct", str(source), *flags])
    said = capsys.readouterr().out
    assert "Stitched 4 of 4 frames" in said
    assert float(said.partition("RMSE ")[2].partition(" mm")[0]) < 0.1
    pictures = {"highlights.png", "matches.png", "mosaic.png", "depth.png", "errors.png"}
    tables = {"matches.csv", "registration.csv", "errors.csv", "mesh.ply", "errors.ply"}
    assert {path.name for path in out.iterdir()} == pictures | tables


@pytest.mark.slow
def test_depth_of_another_source_begins_at_the_scale_of_the_frames():
    exact = _homographies()
    mosaic = blended(exact, CAMERA, lambda k: _load("rgb", k), lambda k: _load("depth", k), 0)
    found = Stitched(mosaic, _sequence(), np.arange(4), ())
    shaded, surface = wall_surface(found, DepthSource(shading=True))
    ratio = shaded.mosaic.depth / mosaic.depth
    assert np.nanmedian(ratio) == pytest.approx(1.0, abs=1e-6)
    assert surface.registration is None  # no true wall is known
    unknown = replace(mosaic, depth=np.full_like(mosaic.depth, np.nan))
    with pytest.raises(InputError, match=r"frames have no depth\. Give --depth, --weights or --sh"):
        wall_surface(replace(found, mosaic=unknown), DepthSource())


def test_depth_by_a_network_is_that_of_the_stitched_image():
    torch = pytest.importorskip("torch", reason="PyTorch is not installed")
    from vrcaps.learn.checkpoint import TrainedNetwork
    from vrcaps.learn.networks import Backbone
    from vrcaps.learn.tasks.depth import DepthTask
    from vrcaps.learn.tasks.super_resolution import SuperResolutionTask

    class Constant(torch.nn.Module):
        def forward(self, image, ray):
            return torch.log(torch.full_like(image[:, :1], 0.02 / 0.03))

    rgb = np.full((40, 60, 3), 90, np.uint8)
    rgb[:5] = 0
    lens = LensPinhole(fx=40.0, fy=40.0, cx=29.5, cy=19.5)
    mosaic = Mosaic(rgb, np.full((40, 60), np.nan, np.float32), Camera("a", lens, 60, 40), 0, (0,))
    depth, has_scale = estimated_depth(
        TrainedNetwork(DepthTask(backbone=Backbone(32)), Constant(), {}), mosaic
    )
    assert has_scale
    assert np.isnan(depth[:5]).all()
    np.testing.assert_allclose(depth[5:], 0.02, atol=1e-5)
    with pytest.raises(InputError, match=r"task 'super-resolution'\. Allowed: 'depth' or 'sfm'"):
        estimated_depth(TrainedNetwork(SuperResolutionTask(), Constant(), {}), mosaic)


def test_bad_input_is_one_clear_line(tmp_path):
    sequence = _sequence()
    with pytest.raises(InputError, match="wall/front has no calibrated camera, which stitching"):
        stitch(replace(sequence, camera=None), StitchSettings())
    blank = replace(sequence, load=lambda channel, index: np.full((SIDE, SIDE, 3), 90, np.uint8))
    with pytest.raises(InputError, match=r"No two of 4 frames of wall/front can be stitched: too"):
        stitch(replace(blank, channels=("rgb",)), StitchSettings())
    with pytest.raises(InputError, match=r"every is 0\. Allowed: 1 or more"):
        StitchSettings(every=0)
    nothing = np.full((4, 4), np.nan)
    with pytest.raises(InputError, match="has no surface"):
        surface_of(nothing, np.zeros((4, 4, 3), np.uint8), CAMERA)


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        (["--shading"], "--shading requires --method stitching"),
        (["--method", "stitching", "--poses", "p.txt"], "--poses requires --method fusion"),
        (
            ["--method", "stitching", "--shading", "--depth", "d"],
            "Several of --depth, --weights and --shading are given",
        ),
    ],
)
def test_flags_that_do_not_go_together_are_told(flags, said, tmp_path, capsys):
    with pytest.raises(SystemExit, match="2"):
        main(["reconstruct", str(tmp_path), "--out", str(tmp_path / "out"), *flags])
    assert said in capsys.readouterr().err
