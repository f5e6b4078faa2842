"""C3VD: round trip in the folders of each reader, and two frames read by the data set's rules."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import yaml

from tests.support.ellipsoid_sequence import ellipsoid_sequence, off_the_wall
from tests.support.exported import assert_same_depth, assert_same_images, round_trip
from tests.support.write_any import write_image
from vrcaps.camera.lens import LensKannalaBrandt, LensPinhole, LensScaramuzza
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.formats.endoscopy.c3vd import C3vd
from vrcaps.formats.io import export

PINHOLE = LensPinhole(fx=25.0, fy=24.0, cx=20.25, cy=17.5)
# C3VD's endoscope, 1350x1080, at 160 px: r in pixels scales as the image.
SCALE = 160 / 1350
FISHEYE = LensScaramuzza(
    769.24 * SCALE,
    -8.1277e-4 / SCALE,
    6.2567e-7 / SCALE**2,
    -1.19662e-9 / SCALE**3,
    cx=80.1,
    cy=64.2,
    c=0.99999,
    d=0.00288,
    e=-0.00296,
)
STEP = 0.1 / 65535
LAYOUTS = ("c3vd", "flat", "endogslam", "ppsnet", "endostreamdepth")


@pytest.fixture
def sequence():
    return ellipsoid_sequence(PINHOLE, 40, 36)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_what_was_written_is_read(sequence, tmp_path, layout):
    found = round_trip(C3vd(layout=layout), sequence, tmp_path / "out")
    assert found.camera.lens == PINHOLE
    assert (found.camera.width, found.camera.height) == (40, 36)
    assert_same_images(found, sequence)
    assert_same_depth(found, sequence, STEP, farthest=65534.49 * STEP)
    for channel, step in (("normal", 2 / 65535), ("flow_backward", 40 / 65535)):
        for k in range(5 if channel in found.channels else 0):
            truth, read = sequence.image(channel, k), found.image(channel, k)
            truth = np.where(np.abs(truth).max(-1, keepdims=True) > 20.0, np.nan, truth)
            np.testing.assert_allclose(read, truth, atol=0.5 * step + 1e-6)
    expected = {"endogslam": 2, "ppsnet": 3}.get(layout, 4)
    assert len(found.channels) == expected


def test_omnidirectional_lens_is_kept(tmp_path):
    sequence = ellipsoid_sequence(FISHEYE, 160, 128, frames=1)
    found = round_trip(C3vd(), sequence, tmp_path / "out")
    assert found.camera.lens == FISHEYE


def test_clouds_of_two_frames_lie_on_one_wall_by_the_rules_of_the_data_set(tmp_path):
    """Ray ((c d; e 1)⁻¹ (u − cx, v − cy), a0 + a2 ρ² + a3 ρ³ + a4 ρ⁴); 65535 is 100 mm; p T."""
    sequence = ellipsoid_sequence(FISHEYE, 160, 128, frames=2, name="ball")
    place = export(C3vd(), [sequence], tmp_path / "out") / "ball"
    text = (place / "camera_omnidirectional_values.txt").read_text()
    _, _, cx, cy, a0, a2, a3, a4, c, d, e = map(float, text.split())
    poses = np.loadtxt(place / "pose.txt", delimiter=",").reshape(-1, 4, 4)
    clouds = []
    for k in range(2):
        stored = cv2.imread(str(place / f"depth/{k:04d}_depth.tiff"), cv2.IMREAD_UNCHANGED)
        depth = np.where((stored == 0) | (stored == 65535), np.nan, stored / 65535 * 100)
        columns, rows = np.meshgrid(np.arange(160) - cx, np.arange(128) - cy)
        plane = np.linalg.inv([[c, d], [e, 1.0]]) @ [columns.ravel(), rows.ravel()]
        rho = np.hypot(*plane)
        forward = a0 + a2 * rho**2 + a3 * rho**3 + a4 * rho**4
        z = depth.ravel()
        points = np.stack([z * plane[0] / forward, z * plane[1] / forward, z, np.ones_like(z)], -1)
        # A step of z is tan θ times as far across: 1.5 µm become 0.04 mm at 88°.
        narrow = np.isfinite(z) & (np.arctan2(rho, forward) < np.radians(88.0))
        points = points[narrow] @ poses[k]
        clouds.append(points[:, :3])
    for cloud in clouds:
        assert len(cloud) > 19000
        assert off_the_wall(cloud / 1000).max() < 0.05e-3
        assert np.median(off_the_wall(cloud / 1000)) < 1e-6
    spread = clouds[1].mean(axis=0) - poses[1][3, :3]
    assert np.linalg.norm(spread) > 1.0  # the transpose matters: rotations are not the identity


@pytest.mark.parametrize("name", ["normals/0001_normals.tiff", "optical_flow/0001_flow.tiff"])
def test_opencv_reads_the_vectors(sequence, tmp_path, name):
    out = export(C3vd(), [sequence], tmp_path / "out")
    stored = cv2.imread(str(next(out.rglob(name))), cv2.IMREAD_UNCHANGED)[..., ::-1].astype(float)
    if "normals" in name:
        truth = sequence.image("normal", 1)
        np.testing.assert_allclose(stored / 65535 * 2 - 1, truth, atol=2e-5)
        assert (truth[..., 2] < 0.2).all()  # facing the camera, +z into the scene
    else:
        truth = sequence.image("flow_backward", 1)
        known = stored.any(axis=-1)
        assert known.mean() > 0.5
        np.testing.assert_allclose(
            (stored[known] / 65535 * 40 - 20)[:, :2], truth[known], atol=4e-4
        )


def test_flow_of_the_first_frame_and_beyond_20_px_is_no_value(sequence, tmp_path):
    def load(channel, index):
        return sequence.load(channel, index) * (30.0 if channel == "flow_backward" else 1)

    far = replace(sequence, load=load, channels=("rgb", "depth", "flow_backward"))
    (found,) = C3vd().read(export(C3vd(), [far], tmp_path / "out"))
    assert np.isnan(found.image("flow_backward", 0)).all()
    truth, read = far.image("flow_backward", 2), found.image("flow_backward", 2)
    is_far = (np.abs(truth) > 20.0).any(axis=-1)
    assert 0 < is_far.sum() < is_far.size
    assert np.isnan(read[is_far]).all()


def test_endogslam_reads_metric_depth(sequence, tmp_path):
    """Its loader divides the stored depth by `png_depth_scale`, and turns `pose.txt` over."""
    out = export(C3vd(layout="endogslam"), [sequence], tmp_path / "out")
    (place,) = out.iterdir()
    config = yaml.safe_load((place / "c3vd.yaml").read_text())["camera_params"]
    stored = cv2.imread(str(place / "depth/0002_depth.tiff"), cv2.IMREAD_UNCHANGED).astype(float)
    depth_mm = stored / config["png_depth_scale"]
    np.testing.assert_allclose(depth_mm, 1e3 * sequence.image("depth", 2), atol=1e-3)
    row = (place / "pose.txt").read_text().splitlines()[2]
    pose = np.array(row.split(","), float).reshape(4, 4).T
    np.testing.assert_allclose(pose[:3, 3], 1e3 * sequence.Ts_world_camera[2, :3, 3], atol=1e-9)


def test_endogslam_depth_of_8_bits_is_read(tmp_path):
    """As its own preparation of C3VD leaves it: 255 is 100 mm."""
    write_image(tmp_path / "s/color/0000_color.png", np.zeros((2, 2, 3), np.uint8))
    write_image(tmp_path / "s/depth/0000_depth.tiff", np.array([[0, 255], [51, 102]], np.uint8))
    (found,) = C3vd(layout="endogslam").read(tmp_path)
    assert found.camera is None
    np.testing.assert_allclose(found.image("depth", 0), [[np.nan, 0.1], [0.02, 0.04]], rtol=1e-6)


def test_ppsnet_finds_its_lists_and_words(sequence, tmp_path):
    parts = [replace(sequence, name=n, split=s) for n, s in (("a", "train"), ("b", "train"))]
    parts.append(replace(sequence, name="c", split="val"))
    out = export(C3vd(layout="ppsnet"), parts, tmp_path / "out")
    assert (out / "train.txt").read_text().strip().split(" ") == ["train/a", "train/b"]
    assert (out / "val.txt").read_text() == "val/c\n"
    words = (out / "val/c/camera.txt").read_text().splitlines()[0].split()
    assert len(words) == 6
    assert list(map(float, words[1:5])) == [25.0, 24.0, 20.25, 17.5]
    row = (out / "val/c/poses_gt.txt").read_text().splitlines()[3].split()
    assert len(row) == 17
    place = [float(row[k]) for k in (4, 8, 12)]
    np.testing.assert_allclose(place, 1e3 * sequence.Ts_world_camera[3, :3, 3], atol=1e-9)


def test_endostreamdepth_has_all_scenes_side_by_side(sequence, tmp_path):
    parts = [replace(sequence, name="a", split="train"), replace(sequence, name="b", split="val")]
    out = export(C3vd(layout="endostreamdepth"), parts, tmp_path / "out")
    assert sorted(p.name for p in (out / "cv3d").iterdir()) == ["a", "b"]
    assert (out / "cv3d/a/0004_color.png").exists()


@pytest.mark.parametrize("compression", [1, 5, 8, 32773])
def test_tiffs_of_any_compression_are_read(tmp_path, compression):
    """None, LZW, Deflate and PackBits, of the real files' kind: no poses, a calibration above."""
    rng = np.random.default_rng(0)
    depth = rng.integers(1, 65535, (8, 10), np.uint16)
    depth[0, :2] = 0, 65535
    options = (cv2.IMWRITE_TIFF_COMPRESSION, compression)
    write_image(tmp_path / "trans_t1_a/0007_color.png", np.zeros((8, 10, 3), np.uint8))
    write_image(tmp_path / "trans_t1_a/0007_depth.tiff", depth, *options)
    values = "10 8 4.5 3.5 7.7 0 -0.06 0.005 -0.0009 0.99 0.003 -0.002"  # with a1 = 0
    (tmp_path / "endoscope_omnidirectional_values.txt").write_text(values)
    (found,) = C3vd(layout="flat").read(tmp_path)
    lens = found.camera.lens
    assert (lens.a0, lens.a2, lens.a4) == (7.7, -0.06, -0.0009)
    assert (lens.c, lens.d, lens.e) == (0.99, 0.003, -0.002)
    read = found.image("depth", 0)
    assert np.isnan(read[0, :2]).all()
    np.testing.assert_allclose(read[1:], depth[1:] / 65535 * 0.1, rtol=1e-6)


def test_pinhole_fit_scales_with_the_image(tmp_path):
    """Half the size has the numbers that EndoGSLAM uses for it, half a pixel apart."""
    write_image(tmp_path / "s/color/0000_color.png", np.zeros((540, 675, 3), np.uint8))
    (found,) = C3vd(layout="endogslam", lens="pinhole-fit").read(tmp_path)
    lens = found.camera.lens
    values = [lens.fx, lens.fy, lens.cx, lens.cy, lens.k1]
    np.testing.assert_allclose(values, [401.1595, 400.9425, 333.893, 273.6165, 0.0], atol=1e-9)
    write_image(tmp_path / "t/0000_color.png", np.zeros((1080, 1350, 3), np.uint8))
    (found,) = C3vd(layout="flat", lens="pinhole-fit").read(tmp_path / "t")
    assert (found.camera.lens.cx, found.camera.lens.k1) == (668.286, -0.42234)


@pytest.mark.parametrize("layout", ["endogslam", "ppsnet"])
def test_readers_of_pinholes_are_told(tmp_path, layout):
    sequence = ellipsoid_sequence(FISHEYE, 160, 128, frames=1)
    with pytest.raises(InputError, match=r"pinholes without distortion.*--rectify"):
        export(C3vd(layout=layout), [sequence], tmp_path / "out")
    assert not list(tmp_path.iterdir())


def test_what_does_not_fit_is_one_clear_line(sequence, tmp_path):
    lens = LensKannalaBrandt(fx=14.0, fy=14.5, cx=19.75, cy=17.5)
    fisheye = ellipsoid_sequence(lens, 40, 36, frames=1)
    with pytest.raises(InputError, match=r"'pinhole', 'scaramuzza'; .* 'kannala-brandt'"):
        export(C3vd(), [fisheye], tmp_path / "out")
    plain = sequence.with_channels(["rgb", "depth"])
    with pytest.raises(InputError, match=r"ppsnet requires the channel 'normal'.*rgb depth normal"):
        export(C3vd(layout="ppsnet"), [plain], tmp_path / "out")
    with pytest.raises(UnknownNameError, match=r"No layout named 'ppsnett'"):
        C3vd(layout="ppsnett")


def test_other_layout_is_named(sequence, tmp_path):
    out = export(C3vd(layout="flat"), [sequence], tmp_path / "out")
    with pytest.raises(InputError, match=r"contains no rgb/\*.png.* It fits the layout 'flat'"):
        C3vd().read(out)


VALUES = "camera_pinhole_values.txt"
OMNI = "camera_omnidirectional_values.txt"


@pytest.mark.parametrize(
    ("layout", "path", "text", "match"),
    [
        ("c3vd", "pose.txt", "1,2,3\n", r"Cannot read .*Rows must contain 16 numbers"),
        ("c3vd", "pose.txt", ",".join(["1"] * 16), "has 1 rows, but there is a frame 4"),
        ("c3vd", VALUES, "40 36 1", r"has 3 numbers. Allowed: width height fx"),
        ("c3vd", OMNI, "40 36 1", r"has 3 numbers. Allowed: width height cx cy a0"),
        ("c3vd", VALUES, "80 72 1 1 1 1 0 0 0 0 0", r"80x72 pixels, but .* has 40x36"),
        ("ppsnet", "camera.txt", "a 1 2\n", "It must contain six words"),
        ("endogslam", "c3vd.yaml", "camera_params: 3\n", "Allowed: 6 numbers"),
        ("endogslam", "c3vd.yaml", "a: [", "Cannot read"),
        ("endogslam", "c3vd.yaml", "- 1", "contains no table"),
    ],
)
def test_damage_is_one_clear_line(sequence, tmp_path, layout, path, text, match):
    out = export(C3vd(layout=layout), [sequence], tmp_path / "out")
    (next(iter(out.rglob("pose*.txt"))).parent / path).write_text(text)
    with pytest.raises(InputError, match=match):
        C3vd(layout=layout).read(out)


def test_vectors_of_8_bits_are_one_clear_line(sequence, tmp_path):
    out = export(C3vd(), [sequence], tmp_path / "out")
    write_image(next(out.rglob("0000_normals.tiff")), np.zeros((36, 40, 3), np.uint8))
    (found,) = C3vd().read(out)
    with pytest.raises(InputError, match=r"not a color image of 16 bits, but uint8"):
        found.image("normal", 0)
