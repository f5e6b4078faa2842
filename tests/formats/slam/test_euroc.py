"""EuRoC MAV and VSLAM-LAB: round trips, what evo reads, and bodies that are no cameras."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import yaml

from tests.support.ellipsoid_sequence import ellipsoid_sequence
from tests.support.exported import assert_same_depth, assert_same_images, round_trip
from vrcaps.camera.lens import LensEquidistant, LensKannalaBrandt, LensPinhole
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import invert, rotation_from_vector, transform_from
from vrcaps.formats.io import export
from vrcaps.formats.shared.text_files import nearest_rows
from vrcaps.formats.slam.euroc import Euroc, VslamLab

PINHOLE = LensPinhole(fx=25.0, fy=24.0, cx=20.25, cy=17.5, k1=-0.02, k2=1e-5, p1=1e-3)
FISHEYE = LensKannalaBrandt(fx=19.0, fy=19.5, cx=19.75, cy=17.5, k1=-0.05, k2=0.002)
FORMS = (Euroc(), VslamLab())


def _body(T_BS, folder):
    """Put another body under an export: rows of poses are its, `T_BS` is the camera's in it."""
    for path in folder.rglob("*.yaml"):
        text = path.read_text()
        plain = text[text.index("[1.0, 0.0") : text.index("0.0, 1.0]") + len("0.0, 1.0]")]
        path.write_text(text.replace(plain, str(np.ravel(T_BS).tolist())))


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.kind)
@pytest.mark.parametrize("lens", [PINHOLE, FISHEYE], ids=lambda lens: lens.kind)
def test_what_was_written_is_read(form, lens, tmp_path):
    sequence = replace(ellipsoid_sequence(lens, 40, 36), split="test")
    found = round_trip(form, sequence, tmp_path / "out")
    assert found.camera.lens == lens
    assert (found.camera.width, found.camera.height, found.split) == (40, 36, "test")
    assert_same_images(found, sequence)
    if form.kind == "vslam-lab":
        assert_same_depth(found, sequence, 1e-5)


def test_equidistant_lens_is_a_fisheye_without_bends(tmp_path):
    sequence = ellipsoid_sequence(LensEquidistant(focal=14.0, cx=19.5, cy=17.5), 40, 36, frames=2)
    found = round_trip(VslamLab(), sequence, tmp_path / "out")
    assert found.camera.lens == LensKannalaBrandt(fx=14.0, fy=14.0, cx=19.5, cy=17.5)


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.kind)
def test_pose_is_that_of_the_camera_in_the_body(form, tmp_path):
    sequence = ellipsoid_sequence(FISHEYE, 40, 36, frames=3)
    T_BS = transform_from(rotation_from_vector(np.array([0.1, -0.4, 0.2])), [0.01, 0.02, -0.03])
    on_body = replace(
        sequence,
        values=sequence.values | {"T_world_camera": sequence.Ts_world_camera @ invert(T_BS)},
    )
    out = export(form, [on_body], tmp_path / "out")
    _body(T_BS, out)
    (found,) = form.read(out)
    np.testing.assert_allclose(found.Ts_world_camera, sequence.Ts_world_camera, atol=1e-9)


def test_files_are_as_vslam_lab_takes_them(tmp_path):
    sequence = ellipsoid_sequence(FISHEYE, 40, 36)
    place = export(VslamLab(), [sequence], tmp_path / "out") / "ball_front"
    rows = (place / "rgb.csv").read_text().splitlines()
    assert rows[0] == "ts_rgb_0 (ns),path_rgb_0,ts_depth_0 (ns),path_depth_0"
    assert rows[2] == "750000000,rgb_0/000001.png,750000000,depth_0/000001.png"
    head, *poses = (place / "groundtruth.csv").read_text().splitlines()
    assert head == "ts (ns),tx (m),ty (m),tz (m),qx,qy,qz,qw"
    assert len(poses) == 5
    (camera,) = yaml.safe_load((place / "calibration.yaml").read_text())["cameras"]
    assert camera["distortion_type"] == "equid4"
    assert camera["distortion_coefficients"] == [-0.05, 0.002, 0.0, 0.0]
    assert (camera["cam_type"], camera["depth_name"], camera["fps"]) == ("rgb+depth", "depth_0", 4)
    stored = cv2.imread(str(place / "depth_0/000002.png"), cv2.IMREAD_UNCHANGED)
    depth = stored / camera["depth_factor"]
    np.testing.assert_allclose(depth, sequence.image("depth", 2), atol=6e-6)


def test_small_numbers_stay_numbers_in_yaml(tmp_path):
    sequence = ellipsoid_sequence(PINHOLE, 40, 36, frames=1)
    out = export(Euroc(), [sequence], tmp_path / "out")
    plain = yaml.safe_load(next(out.rglob("sensor.yaml")).read_text())
    assert plain["distortion_coefficients"] == [-0.02, 1e-5, 1e-3, 0.0]
    assert plain["rate_hz"] == 1


@pytest.mark.slow
def test_evo_reads_the_same_trajectory(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))  # evo writes its settings there
    from evo.core import metrics
    from evo.core.trajectory import PoseTrajectory3D
    from evo.tools.file_interface import read_euroc_csv_trajectory

    sequence = ellipsoid_sequence(FISHEYE, 40, 36)
    out = export(Euroc(), [sequence], tmp_path / "out")
    read = read_euroc_csv_trajectory(next(out.rglob("state_groundtruth_estimate0/data.csv")))
    poses = list(sequence.Ts_world_camera)
    truth = PoseTrajectory3D(poses_se3=poses, timestamps=sequence.times)
    np.testing.assert_allclose(read.timestamps, truth.timestamps, atol=1e-9)
    error = metrics.APE(metrics.PoseRelation.full_transformation)
    error.process_data((truth, read))
    assert error.get_statistic(metrics.StatisticsType.max) < 1e-10


def test_real_rows_are_longer_denser_and_shorter_in_time(tmp_path):
    """EuRoC's own: 17 columns at 200 Hz, two cameras in gray, images before the first pose."""
    sequence = ellipsoid_sequence(FISHEYE, 40, 36)
    out = export(Euroc(), [sequence], tmp_path / "out")
    mav = out / "ball_front" / "mav0"
    path = mav / "state_groundtruth_estimate0" / "data.csv"
    head, *rows = path.read_text().splitlines()
    late = [row.split(",") for row in rows[1:]]
    near = [[str(int(row[0]) + 4_000_000), *row[1:]] for row in late]
    far = [[str(int(row[0]) + 9_000_000), "9", *row[2:]] for row in late]
    text = "\n".join(",".join([*row, *["0"] * 9]) for row in (*far, *near))
    path.write_text(f"{head},v,b\n{text}\n")
    (mav / "cam0").rename(mav / "cam1")
    (first,) = Euroc().read(out)
    np.testing.assert_allclose(first.times, sequence.times[1:])
    np.testing.assert_allclose(first.Ts_world_camera, sequence.Ts_world_camera[1:], atol=1e-9)
    np.testing.assert_array_equal(first.image("rgb", 0), sequence.image("rgb", 1))


def test_rows_that_are_far_in_time_do_not_belong():
    times = np.array([0.0, 1.0, 2.0, 3.0])
    others = np.array([2.03, 0.99, -0.001, 1.02])
    assert nearest_rows(times, others).tolist() == [2, 1, -1, -1]
    assert nearest_rows(times, others[:1]).tolist() == [-1, -1, -1, -1]
    assert nearest_rows(times, others[:0]).tolist() == [-1, -1, -1, -1]


def test_lens_that_does_not_fit_is_one_clear_line(tmp_path):
    bent = ellipsoid_sequence(replace(PINHOLE, k3=0.01), 40, 36, frames=1)
    with pytest.raises(InputError, match=r"has k3 = 0.01, which this format cannot hold.*rectify"):
        export(Euroc(), [bent], tmp_path / "out")
    assert round_trip(VslamLab(), bent, tmp_path / "lab").camera.lens.k3 == 0.01
    skew = ellipsoid_sequence(replace(PINHOLE, skew=0.5), 40, 36, frames=1)
    with pytest.raises(InputError, match="skew"):
        export(VslamLab(), [skew], tmp_path / "out")


EUROC, LAB = "mav0/cam0/sensor.yaml", "calibration.yaml"


@pytest.mark.parametrize(
    ("kind", "path", "text", "match"),
    [
        ("euroc", EUROC, "distortion_model: fov", "distortion model fov. Allowed: radial"),
        ("euroc", EUROC, "distortion_model: none\nresolution: 3", "Allowed: 2 numbers"),
        ("euroc", "mav0/cam0/data.csv", "5\n", "row without the name of an image"),
        ("euroc", "mav0/cam0/data.csv", "#t,f\n1.5,a.png\n", "the time '1.5' in row 1"),
        ("euroc", "mav0/cam0/data.csv", b"\xff\xff", "Cannot read"),
        ("euroc", "mav0/state_groundtruth_estimate0/data.csv", "1,2\n", "Cannot read"),
        ("euroc", "mav0/state_groundtruth_estimate0/data.csv", "9,0,0,0,1,0,0,0\n", "no pose"),
        ("vslam-lab", LAB, "cameras: 3", "has no list of cameras"),
        ("vslam-lab", "rgb.csv", "ts,path\n", "has no images"),
        ("vslam-lab", "groundtruth.csv", "9,0,0,0,0,0,0,1\n", "no pose within 20 ms"),
    ],
)
def test_damage_is_one_clear_line(tmp_path, kind, path, text, match):
    form = {one.kind: one for one in FORMS}[kind]
    out = export(form, [ellipsoid_sequence(FISHEYE, 40, 36, frames=2)], tmp_path / "out")
    content = text if isinstance(text, bytes) else text.encode()
    (out / "ball_front" / path).write_bytes(content)
    with pytest.raises(InputError, match=match):
        form.read(out)


def test_distortion_that_no_lens_has_is_one_clear_line(tmp_path):
    out = export(VslamLab(), [ellipsoid_sequence(FISHEYE, 40, 36, frames=2)], tmp_path / "out")
    path = out / "ball_front" / LAB
    text = path.read_text()
    path.write_text(text.replace("equid4", "fov1"))
    with pytest.raises(InputError, match=r"distortion_type fov1. Allowed: radtan4"):
        VslamLab().read(out)
    path.write_text(text.replace("depth_factor: 100000.0", "depth_factor: deep"))
    with pytest.raises(InputError, match=r"\['deep'\] for depth_factor\. Allowed: 1 numbers"):
        VslamLab().read(out)
    with pytest.raises(InputError, match=r"depth_factor is 0.5. Allowed: 1 or more"):
        VslamLab(depth_factor=0.5)


@pytest.mark.parametrize("name", ["*", "%s", "#c", "!x", "{}", "@x"])
def test_names_are_no_yaml(tmp_path, name):
    sequence = replace(ellipsoid_sequence(FISHEYE, 40, 36, frames=2), name=name)
    (read,) = Euroc().read(export(Euroc(), [sequence], tmp_path / "out"))
    assert read.name == name
