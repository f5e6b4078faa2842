import math
from dataclasses import replace

import numpy as np
import pytest

from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.geometry import (
    invert,
    look_along,
    matrix_from_quaternion,
    quaternion_from_matrix,
    transform_from,
)
from vrcaps.core.units import DM, MM
from vrcaps.motion.replay import Replay, read_euroc_csv, read_tum, read_unity_csv, replay
from vrcaps.organ.surface import CLOSED_RADIUS
from vrcaps.world.wall_displacement import WallDisplacement

HEADER = "tX;tY;tZ;rX;rY;rZ;rW;time(s)\n"
ROWS = [f"{0.1 * i};0;0;0;0;0;1;{0.5 * i}\n" for i in range(6)]


def _write(tmp_path, text, name="path.csv"):
    path = tmp_path / name
    path.write_text(text)
    return path


def _unity(tmp_path, text, *, unit="m", handedness="left"):
    return read_unity_csv(_write(tmp_path, text), unit=unit, handedness=handedness)


def test_unity_axes(tmp_path):
    """Unity's right, up and ahead become world x, z and y; so do the camera's own axes."""
    text = HEADER + "1;2;3;0;0;0;1;0\n1;2;3;0;0;0;1;1\n"
    pose = _unity(tmp_path, text, unit="dm").Ts_world_capsule[0]
    np.testing.assert_allclose(pose[:3, 3], [0.1, 0.3, 0.2])
    right, down, ahead = pose[:3, :3].T
    np.testing.assert_allclose(right, [1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(down, [0, 0, -1], atol=1e-15)
    np.testing.assert_allclose(ahead, [0, 1, 0], atol=1e-15)


@pytest.mark.parametrize("handedness", ["left", "right"])
def test_y_up_conversion_keeps_distances_and_hands(tmp_path, rng, handedness):
    """Camera coordinates of a point are the same before and after, up to the axes' names."""
    q, t = rng.normal(size=4), rng.normal(size=3)
    q /= np.linalg.norm(q)
    row = ";".join(f"{v:.17g}" for v in (*t, *q))
    trajectory = _unity(tmp_path, f"{HEADER}{row};0\n{row};1\n", handedness=handedness)
    pose = trajectory.Ts_world_capsule[0]
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1.0)
    point = rng.normal(size=3)  # in the file's frame
    x, y, z = matrix_from_quaternion(np.roll(q, 1)).T @ (point - t)  # in the file's camera
    mirrored = handedness == "left"
    point_world = point[[0, 2, 1]] if mirrored else np.array([point[0], -point[2], point[1]])
    in_camera = (invert(pose) @ [*point_world, 1.0])[:3]
    np.testing.assert_allclose(in_camera, [x, -y, z if mirrored else -z], atol=1e-12)


def test_unity_mends_and_notes(tmp_path):
    """A cut-off last line and a first pose from which the path jumps are dropped and noted."""
    jump = "0;0;0;0;0.9;0;0.4358898943540674;-0.5\n"
    trajectory = _unity(tmp_path, HEADER + jump + "".join(ROWS) + "0.6;0;0")
    assert len(trajectory) == 6
    assert trajectory.notes == (
        "Dropped line 9, the last, which is cut off.",
        "Dropped line 2, the first pose, from which the path jumps.",
    )


def test_unity_first_position_jump(tmp_path):
    trajectory = _unity(tmp_path, HEADER + "9;9;9;0;0;0;1;-1\n" + "".join(ROWS))
    assert len(trajectory) == 6
    assert len(trajectory.notes) == 1


def test_decimal_commas_and_comma_separators(tmp_path):
    plain = _unity(tmp_path, HEADER + "".join(ROWS))
    commas = _unity(tmp_path, HEADER + "".join(ROWS).replace(".", ","))
    separated = _unity(tmp_path, (HEADER + "".join(ROWS)).replace(";", ","))
    for other in (commas, separated):
        np.testing.assert_array_equal(other.Ts_world_capsule, plain.Ts_world_capsule)


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("", "starts with .*, not the header tX"),
        ("x;y\n1;2\n", "not the header tX;tY;tZ;rX;rY;rZ;rW;time"),
        (HEADER + ROWS[0], "contains 1 poses. Allowed: 2 or more"),
        (
            HEADER + ROWS[0] + "nan;0;0;0;0;0;1;1\n" + ROWS[3],
            "line 3 contains a value that is not fin",
        ),
        (HEADER + ROWS[0] + "a;0;0;0;0;0;1;1\n", "line 3 does not contain a number"),
        (HEADER + ROWS[0] + "1;2\n" + ROWS[1], "line 3 has 2 values, not 8; only a cut-off last"),
        (HEADER + ROWS[0] + "0;0;0;0;0;0;2;1\n", "line 3 contains a quaternion of length 2, not 1"),
        (HEADER + ROWS[1] + ROWS[0], r"line 3: time 0 s does not come after 0\.5 s"),
        (
            "tX,tY,tZ,rX,rY,rZ,rW,time(s)\n" + "0,0,0,0,0,0,1,0\n" + "0,5,0,0,0,0,0,1,1\n",
            "line 3 has 9 values, not 8: decimal commas need ';'",
        ),
    ],
)
def test_bad_unity_files(tmp_path, text, match):
    with pytest.raises(InputError, match=match):
        _unity(tmp_path, text)


def test_unity_bad_arguments(tmp_path):
    with pytest.raises(InputError, match="Unknown length unit 'furlong'"):
        _unity(tmp_path, HEADER + "".join(ROWS), unit="furlong")
    with pytest.raises(UnknownNameError, match=r"No handedness named 'both'\. Known: left, right"):
        _unity(tmp_path, HEADER + "".join(ROWS), handedness="both")
    with pytest.raises(InputError, match=r"Cannot read the path file .*missing"):
        read_unity_csv(tmp_path / "missing.csv", unit="m", handedness="left")


def test_tum_round_trip(tmp_path, rng):
    """Numbers written as TUM come back; comments and blank lines are skipped."""
    wxyz = rng.normal(size=(5, 4))
    wxyz /= np.linalg.norm(wxyz, axis=1, keepdims=True)
    positions = rng.normal(size=(5, 3))
    lines = ["# a comment", ""]
    for i in range(5):
        numbers = [0.1 * i, *(positions[i] / DM), *wxyz[i, 1:], wxyz[i, 0]]
        lines.append(" ".join(f"{n:.17g}" for n in numbers))
    trajectory = read_tum(_write(tmp_path, "\n".join(lines), "path.txt"), unit="dm")
    expected = transform_from(matrix_from_quaternion(wxyz), positions)
    np.testing.assert_allclose(trajectory.Ts_world_capsule, expected, atol=1e-12)
    np.testing.assert_allclose(trajectory.times, 0.1 * np.arange(5))


def test_tum_with_nan(tmp_path):
    path = _write(tmp_path, "0 0 0 0 0 0 0 1\n1 0 nan 0 0 0 0 1\n2 0 0 0 0 0 0 1\n")
    with pytest.raises(InputError, match=r"line 2 contains a value that is not finite \(1 0 nan"):
        read_tum(path, unit="m")


def _tum_along_the_axis(tmp_path, model, *, of_camera, offset=(0.0, 0.0, 0.0)):
    """A path down the straight part of the tube, looking along it."""
    line = model.organ.centerline
    centers = line.points[40:70] @ model.T_world_patient[:3, :3].T + offset
    forward = np.gradient(centers, axis=0)
    Ts = transform_from(look_along(forward, np.array([0.0, 0.0, 1.0])), centers)
    if of_camera:
        Ts = Ts @ model.device.cameras[0].T_capsule_camera
    wxyz = quaternion_from_matrix(Ts[:, :3, :3])
    rows = np.column_stack([100.0 + np.arange(30) / 10, Ts[:, :3, 3], wxyz[:, 1:], wxyz[:, 0]])
    path = tmp_path / "path.tum"
    np.savetxt(path, rows, fmt="%.17g")
    return path, centers


@pytest.mark.parametrize("pose", ["camera", "capsule"])
def test_replay_puts_the_capsule_where_the_file_says(tmp_path, model, pose):
    path, centers = _tum_along_the_axis(tmp_path, model, of_camera=pose == "camera")
    settings = Replay(str(path), "tum", "m", pose=pose, start=0.2)
    trajectory = replay(model, settings, frames=10, fps=10.0)
    np.testing.assert_allclose(trajectory.Ts_world_capsule[:, :3, 3], centers[2:12], atol=1e-9)
    np.testing.assert_allclose(trajectory.times, np.arange(10) / 10.0)


def test_replay_in_the_patient_frame_and_placed(tmp_path, model):
    """`frame` and `T_frame_recording` compose: T_world_patient · T_frame_recording · pose."""
    path, centers = _tum_along_the_axis(tmp_path, model, of_camera=False)
    placement = model.T_world_patient.T.copy()  # a rotation about the origin, so its inverse
    settings = Replay(
        str(path), "tum", "m", pose="capsule", frame="patient",
        T_frame_recording=tuple(map(tuple, placement.tolist())),
    )  # fmt: skip
    trajectory = replay(model, settings, frames=5, fps=10.0)
    np.testing.assert_allclose(trajectory.Ts_world_capsule[:, :3, 3], centers[:5], atol=1e-9)


def test_replay_outside_the_lumen(tmp_path, model):
    path, _ = _tum_along_the_axis(tmp_path, model, of_camera=True, offset=(0.0, 0.0, 0.1))
    with pytest.raises(
        InputError,
        match=r"mm outside the lumen of 'tube' at frame 0 .* motion\.allow_outside=true\.",
    ):
        replay(model, Replay(str(path), "tum", "m"), frames=5, fps=10.0)
    allowed = Replay(str(path), "tum", "m", allow_outside=True)
    assert len(replay(model, allowed, frames=5, fps=10.0)) == 5


def test_a_slack_lumen_closes_around_a_replayed_path(tmp_path, model):
    path, _ = _tum_along_the_axis(tmp_path, model, of_camera=False)
    organ = replace(model.organ, metadata={**model.organ.metadata, CLOSED_RADIUS: 2 * MM})
    slack = replace(model, organ=organ)
    settings = Replay(str(path), "tum", "m", pose="capsule")
    state = settings.begin(slack, frames=2, fps=10.0, seed=0).state(1)
    expected = WallDisplacement(slack, slack).vertices_world(state.T_world_capsule)
    assert expected is not None
    np.testing.assert_array_equal(state.vertices_world, expected)
    assert np.abs(expected - slack.vertices_world).max() > 2 * MM
    rigid = replace(settings, rigid_wall=True).begin(slack, frames=2, fps=10.0, seed=0)
    assert rigid.state(1).vertices_world is None


@pytest.mark.parametrize(
    ("change", "error", "match"),
    [
        ({"format": "bvh"}, UnknownNameError, "No format named 'bvh'"),
        ({"start": 2.9}, InputError, "The recorded path covers 0 s to 2.9 s, but the frames need"),
        ({"start": math.nan}, InputError, "start is nan. Allowed: any finite number"),
        ({"T_frame_recording": ((2.0, 0, 0, 0),) * 4}, InputError, "is not a rigid transform"),
        ({"T_frame_recording": ((1.0, 0, 0, 0),)}, InputError, "is not a rigid transform"),
    ],
)
def test_bad_replay_settings(tmp_path, model, change, error, match):
    path, _ = _tum_along_the_axis(tmp_path, model, of_camera=True)
    with pytest.raises(error, match=match):
        settings = Replay(**{"path": str(path), "format": "tum", "unit": "m", **change})
        replay(model, settings, frames=5, fps=10.0)


def test_recorded_unity_path(shared_data):
    """The real recording: last line cut, first row jumps; 130 mm of travel in 43.5 s."""
    path = shared_data / "poses" / "fork_record_scene_run1_1308poses.csv"
    trajectory = read_unity_csv(path, unit="dm", handedness="left")
    assert len(trajectory) == 1307
    assert len(trajectory.notes) == 2
    assert trajectory.times[-1] == pytest.approx(43.56675)
    assert np.linalg.norm(trajectory.linear_velocities_world, axis=1).max() < 0.1
    assert np.linalg.norm(trajectory.angular_velocities_world, axis=1).max() < 13.0


def _rows(layout: str) -> list[str]:
    """A turn of 40° about z, moving along x; EuRoC has ns, commas and w first."""
    w, z = np.cos(np.radians(20.0)), np.sin(np.radians(20.0))
    start = 1_403_636_579_763_555_584
    if layout == "tum":
        return [f"{1403636579.75 + 0.25 * k} {0.01 * k} 0 0 0 0 {z} {w}" for k in range(6)]
    return [f"{start + k * 250_000_000},{0.01 * k},0,0,{w},0,0,{z},9,9" for k in range(6)]


@pytest.mark.parametrize("layout", ["tum", "euroc"])
@pytest.mark.parametrize("start", ["", "\ufeff", "# a comment\n"])
def test_a_path_of_slam_is_read_in_its_own_layout(tmp_path, layout, start):
    path = _write(tmp_path, start + "\n".join(_rows(layout)))
    found = (read_tum if layout == "tum" else read_euroc_csv)(path, unit="m")
    assert found.times[-1] - found.times[0] == pytest.approx(1.25, abs=1e-6)
    x_axis = [np.cos(np.radians(40.0)), np.sin(np.radians(40.0)), 0.0]
    np.testing.assert_allclose(found.Ts_world_capsule[0, :3, 0], x_axis, atol=1e-9)
    np.testing.assert_allclose(found.linear_velocities_world[2], [0.04, 0, 0], atol=1e-6)


@pytest.mark.parametrize(
    ("lines", "reason"),
    [
        (["#timestamp [ns],p_x,p_y,p_z,q_w,q_x,q_y,q_z", *_rows("euroc")], "names qw first"),
        (
            ["#timestamp, p_RS_R_x [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []"],
            "names qw first",
        ),
        (_rows("euroc"), "it has commas"),
        ([row.replace(",", " ").replace(" 9 9", "") for row in _rows("euroc")], "in nanoseconds"),
        (["# time x y z qw qx qy qz", *_rows("tum")], "names qw first"),
        ([row.replace(" ", ",") for row in _rows("tum")], "it has commas"),
    ],
)
def test_a_path_of_another_layout_is_no_tum(tmp_path, lines, reason):
    path = _write(tmp_path, "\n".join(lines))
    with pytest.raises(InputError, match=rf"not in the layout TUM: .*{reason}.*'euroc'"):
        read_tum(path, unit="m")


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (_rows("tum"), "has 1 values, not 8"),
        ([row.replace(" ", ",") for row in _rows("tum")], "have whole nanoseconds.*'tum'"),
        (["#t,x,y,z,qx,qy,qz,qw", *_rows("euroc")], "line 1 names qx first"),
        (_rows("euroc")[:1], "contains 1 poses"),
        ([*_rows("euroc"), _rows("euroc")[-1]], "Times must increase"),
        ([row.replace(",0,0,", ",0,nan,", 1) for row in _rows("euroc")], "not finite"),
        ([row.replace(",0,0,", ",0,1e300,", 1) for row in _rows("euroc")], "beyond 1e9 m"),
    ],
)
def test_a_path_of_another_layout_is_no_euroc(tmp_path, lines, message):
    with pytest.raises(InputError, match=message):
        read_euroc_csv(_write(tmp_path, "\n".join(lines)), unit="m")


def test_replay_takes_a_path_of_euroc(tmp_path, model):
    path = _write(tmp_path, "\n".join(_rows("euroc")))
    settings = Replay(str(path), "euroc", "m", allow_outside=True)
    assert len(replay(model, settings, frames=5, fps=10.0)) == 5
