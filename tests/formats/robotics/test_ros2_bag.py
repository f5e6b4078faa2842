"""ROS 2 bags: round trip, and an independent reader: SQLite and CDR by its specification."""

import sqlite3
import struct
from dataclasses import replace

import numpy as np
import pytest

from vrcaps.core.errors import InputError, MissingExtraError
from vrcaps.core.geometry import matrix_from_quaternion
from vrcaps.formats.io import export
from vrcaps.formats.robotics.ros2_bag import Ros2Bag, _Bag
from vrcaps.formats.robotics.ros_messages import state_messages
from vrcaps.recording.table import FrameTable

pytest.importorskip("rosbags")
STORED = ("rgb", "depth", "label", "instance", "occlusion")


def rows(path):
    """Type, and times [ns] and CDR of all messages, by topic, read by SQLite."""
    with sqlite3.connect(path) as database:
        query = "SELECT name, type, timestamp, data FROM messages JOIN topics ON topic_id=topics.id"
        found = {}
        for name, kind, ns, data in database.execute(f"{query} ORDER BY messages.id"):
            found.setdefault((name, kind), []).append((ns, data))
    database.close()
    return found


def pose_of(data):
    """`PoseStamped` in little-endian CDR (OMG DDSI-RTPS 2.5, sec. 10; alignment after 4 bytes)."""
    assert data[:2] == b"\0\1"
    body = data[4:]
    sec, nanosec, length = struct.unpack_from("<iII", body)
    frame = body[12 : 12 + length - 1].decode()
    start = -(-(12 + length) // 8) * 8
    x, y, z, qx, qy, qz, qw = struct.unpack_from("<7d", body, start)
    return sec * 10**9 + nanosec, frame, np.array([x, y, z]), np.array([qw, qx, qy, qz])


def test_what_was_written_is_read(fisheye_episode, tmp_path):
    sequence = replace(fisheye_episode.sequence(), split="train", patient="7")
    (found,) = Ros2Bag().read(export(Ros2Bag(), [sequence], tmp_path / "out"))
    assert (found.name, found.split, found.patient) == (sequence.name, "train", "7")
    assert found.camera == sequence.camera
    assert found.channels == STORED
    np.testing.assert_allclose(found.times, sequence.times, atol=0.5e-9)
    for name in ("T_world_camera", "T_world_capsule"):
        np.testing.assert_allclose(found.values[name], sequence.values[name], atol=1e-9)
    for channel in STORED:
        values = found.image(channel, 3)
        assert values.dtype == sequence.image(channel, 3).dtype
        np.testing.assert_array_equal(values, sequence.image(channel, 3))


def test_an_independent_reader_finds_the_same_poses_and_images(pinhole_episode, tmp_path):
    out = export(Ros2Bag(), [pinhole_episode.sequence()], tmp_path / "out")
    (path,) = out.rglob("*.db3")
    found = rows(path)
    poses = found["/capsule/pose", "geometry_msgs/msg/PoseStamped"]
    expected = pinhole_episode.Ts_world_capsule
    for k, (ns, data) in enumerate(poses):
        stamp, frame, position, wxyz = pose_of(data)
        assert (stamp, frame) == (ns, "world")
        assert ns == round(pinhole_episode.times[k] * 1e9)
        np.testing.assert_allclose(position, expected[k, :3, 3], atol=1e-12)
        np.testing.assert_allclose(matrix_from_quaternion(wxyz), expected[k, :3, :3], atol=1e-9)
    assert len(poses) == len(pinhole_episode)
    images = found["/front/rgb", "sensor_msgs/msg/Image"]
    last = images[-1][1][-36 * 40 * 3 :]
    image = np.frombuffer(last, np.uint8).reshape(36, 40, 3)
    np.testing.assert_array_equal(image, pinhole_episode.image("front", "rgb", 4))
    assert ("/front/camera_info", "sensor_msgs/msg/CameraInfo") in found
    times = [ns for messages in found.values() for ns, _ in messages]
    assert min(times) >= 0


def test_sensors_joints_and_commands_are_standard_messages(tmp_path):
    from rosbags.rosbag2 import Reader
    from rosbags.typesys import Stores, get_typestore

    names = {"accelerometer_{}_m_per_s2": 1, "gyroscope_{}_rad_per_s": 4, "magnetometer_{}_t": 7}
    names |= {"commanded_force_{}_n": 10, "commanded_torque_{}_nm": 13}
    columns = {
        name.format(axis): np.array([0.0, first + k])
        for name, first in names.items()
        for k, axis in enumerate("xyz")
    }
    columns |= {"joint_1_rad": np.array([0.0, 0.5]), "coil_1_current_a": np.array([0.0, 20.0])}
    with _Bag.writing(tmp_path / "bag") as bag:
        for message in state_messages(FrameTable(columns), 1, 1.5):
            bag.send(message)
    store, found = get_typestore(Stores.ROS2_HUMBLE), {}
    with Reader(tmp_path / "bag") as reader:
        for connection, ns, data in reader.messages():
            assert ns == 1_500_000_000
            found[connection.topic] = store.deserialize_cdr(data, connection.msgtype)
    imu = found["/capsule/imu"]
    assert (imu.linear_acceleration.x, imu.angular_velocity.z) == (1.0, 6.0)
    assert imu.orientation_covariance[0] == -1.0
    assert found["/capsule/magnetometer"].magnetic_field.y == 8.0
    assert found["/capsule/command"].wrench.torque.z == 15.0
    assert found["/joint_states"].name == ["joint_1"]
    assert found["/joint_states"].position.tolist() == [0.5]
    assert found["/coils/joint_states"].effort.tolist() == [20.0]


def test_what_is_no_bag_is_one_line(tmp_path, monkeypatch, pinhole_episode):
    with pytest.raises(InputError, match=r"contains no ROS 2 bag: no metadata\.yaml"):
        Ros2Bag().read(tmp_path)
    (tmp_path / "metadata.yaml").write_text("nonsense")
    with pytest.raises(InputError, match="Cannot read") as raised:
        Ros2Bag().read(tmp_path)
    assert "\n" not in str(raised.value)
    monkeypatch.setitem(__import__("sys").modules, "rosbags.rosbag2", None)
    with pytest.raises(MissingExtraError, match=r"rosbags is not installed.*vrcaps\[robots\]"):
        export(Ros2Bag(), [pinhole_episode.sequence()], tmp_path / "out")
    assert not (tmp_path / "out").exists()
